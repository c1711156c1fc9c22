"""The limits that a driver is held to."""

from __future__ import annotations

import math
from dataclasses import dataclass

from armimp_common.realtime import LATE_NS
from armimp_common.topics import NS_PER_S, PERIOD_NS


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of all checks; those that the interfaces page does not state are marked as chosen.

    Attributes
    ----------
    angle : largest angle, rad; two turns: chosen
    step : largest change of an angle in one period, rad; 100 rad/s: chosen
    torque : largest torque, N·m; chosen
    encoder, transducer : coarsest resolution that the study covers, rad and N·m
    rate : relative error of the rate by the wall clock; chosen
    clock : relative error of the mean step of the stamps, which the estimator allows
    late : time after its deadline from which a sample counts as late, s
    late_share : largest share of late samples, as in a valid run
    latency : largest 99 % quantile of sample to command, s, as in a valid run
    reaction : largest number of periods from a command to its first effect; chosen
    share : least part of a torque that must be seen to go for all of it to count as gone; chosen
    blur : error with which that moment can be seen, s; measured with the simulated rig
    ending : time until torque that is to go has gone: 5 periods and 50 ms, s
    answer : time for the answer of a service, s; chosen
    told : time until a fault is on /diagnostics, s: it is repeated every second
    least : samples without which nothing is judged
    """

    angle: float = 4.0 * math.pi
    step: float = 0.1
    torque: float = 500.0
    encoder: float = 2.0 * math.pi / 51200
    transducer: float = 0.02
    rate: float = 0.005
    clock: float = 2e-4
    late: float = LATE_NS / NS_PER_S
    late_share: float = 0.01
    latency: float = 0.001
    reaction: int = 3
    share: float = 0.65
    blur: float = 0.01
    ending: float = 5 * PERIOD_NS / NS_PER_S + 0.05
    answer: float = 0.5
    told: float = 1.5
    least: int = 100
