"""The controller without ROS: samples in, commands and perturbations out, trial after trial."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.status import NOTICE_TICKS, Cause, Phase, StoppingDecision, TrialStatus
from armimp_common.topics import PERIOD, PERIOD_NS, clock_step
from armimp_control.laws import NO_JOINT
from armimp_control.laws.law import Controller, compile_law
from armimp_control.parameters import ControllerParameters
from armimp_control.safety_limiter import SafetyParameters, SaturationCounter
from armimp_control.sequence import Segment, Tare, timetable

Reading = tuple[float, ...]
_MOST_WAITING = 10_000
"""Most readings that may wait for their partners."""


class TrialSequencer:
    """Answers each sample with a command, and leads through the trials.

    Parameters
    ----------
    parameters : ControllerParameters
    announce : called with every new status, before the command that it concerns

    Attributes
    ----------
    command : (n,) N·m, answer to the last sample
    tau_delta : (n,) N·m, perturbation of the last sample
    cause, fault : why the experiment has ended early, as a code and in words; else NONE and empty
    lost : number of samples that were missing between others in the present trial
    finished : whether all trials are over, in good order or not
    controller : the law and its safety limiter
    tick : number of samples answered
    warnings : of the stability check

    Raises
    ------
    ConfigurationError
        If the parameters do not fit together or the loop would be unstable.
    """

    def __init__(
        self, parameters: ControllerParameters, announce: Callable[[TrialStatus], None]
    ) -> None:
        self.warnings = parameters.check()
        self._parameters, self._announce = parameters, announce
        n = len(parameters.joints)
        self.controller = Controller(parameters.control_law(), safety=parameters.safety)
        segments = timetable(parameters.sequence, joints=n, tare=parameters.tare)
        self._segment, self._ahead = segments[0], iter(segments)
        self._planned = round(parameters.sequence.duration / PERIOD)
        self._ticks = self._planned
        self._until = 0
        self._due: int | None = None
        self._start_ns: int | None = None
        self._next_ns: int | None = None  # stamp that is expected
        self._signal: FloatArray = np.zeros(0)
        # In lockstep each is made when its trial begins, as memory then matters more than time.
        prepared = range(n) if parameters.mode == "realtime" else ()
        self._signals = {joint: self._make_signal(joint) for joint in prepared}
        self._fill = partial(struct.Struct(f"{2 * n}d").pack_into, self.controller.sample.data, 0)
        self._at_rest = np.zeros((n, parameters.tare.ticks))
        self._tare: Tare | None = None
        self.command, self.tau_delta = self.controller.command, self.controller.sample[2]
        self._compute = self.controller.compute
        self._saturation = SaturationCounter()
        self.cause, self.fault = Cause.NONE, ""
        self.tick = self.lost = 0
        self.finished = False
        compile_law(self.controller.law, parameters.safety)

    def answer(self, stamp_ns: int, theta: Sequence[float], tau_h: Sequence[float]) -> None:
        """Compute :attr:`command` and :attr:`tau_delta` for one sample.

        A sample that is wrong in any way ends the experiment, and nothing of it is used.

        Parameters
        ----------
        stamp_ns : of the sample, ns
        theta : (n,) encoder readings, rad
        tau_h : (n,) torque on the arm, N·m
        """
        if not self.finished:
            if stamp_ns != self._next_ns:
                self._check_stamp(stamp_ns)
            self._next_ns = stamp_ns + PERIOD_NS
            if self.tick >= self._until and not self.finished:
                self._advance(stamp_ns)
        self._control(theta, tau_h)
        self.tick += 1

    @property
    def at_rest(self) -> bool:
        """Whether the experiment is over and the torque is zero."""
        return self.finished and not self.command.any()

    @property
    def awaits_decision(self) -> bool:
        """Whether a decision that the estimator has announced is due before the next sample."""
        return self._due is not None and self._place >= self._due + NOTICE_TICKS

    def decide(self, decision: StoppingDecision) -> None:
        """End the present trial early if its estimates are good enough already.

        The perturbation then ends :data:`NOTICE_TICKS` samples after those that were judged or, if
        it is too late for that, as many samples from now. Its end is announced at once.
        """
        segment = self._segment
        if self.finished or segment.phase is not Phase.PERTURB:
            return
        if decision.trial != segment.trial or decision.samples > self._place:
            return  # the decision is on another experiment
        self._due = decision.due
        end = decision.samples + NOTICE_TICKS
        if end < self._place:
            end = self._place + NOTICE_TICKS
        if decision.enough and end < segment.ticks:
            self._enter(replace(segment, ticks=end))
            self._ticks = end
            self._tell(Phase.PERTURB)

    @property
    def _place(self) -> int:
        """Number of samples answered in the present phase."""
        return self.tick - self._segment.first

    def abort(self, cause: Cause, reason: str) -> None:
        """End the experiment with zero torque at once. The first reason is kept."""
        self.controller.cut()
        self._end(cause, reason)

    def stop(self, cause: Cause, reason: str) -> None:
        """End the experiment and let the torque ramp down to zero. The first reason is kept.

        The ramp advances by one tick with each further answer, or is continued by `controller`.
        """
        self.controller.stop()
        self._end(cause, reason)

    def _end(self, cause: Cause, reason: str) -> None:
        self.tau_delta[:] = 0.0
        self._due = None
        if not self.finished:
            self.finished = True
            self.cause, self.fault = cause, reason
            self._tell(Phase.ABORTED)

    def _check_stamp(self, stamp_ns: int) -> None:
        """Check what the limiter cannot know: the order of samples, and gaps between them."""
        if self._next_ns is None:
            return
        last = self._next_ns - PERIOD_NS
        if jump := clock_step(last, stamp_ns):
            self.abort(Cause.STAMPS, jump)
        elif stamp_ns <= last:
            self.abort(
                Cause.STAMPS, f"stamp {stamp_ns} ns follows {last} ns: samples must move forward"
            )
        else:
            self.lost += max(round((stamp_ns - last) / PERIOD_NS) - 1, 0)

    def _advance(self, stamp_ns: int) -> None:
        """Enter the next phase, as its first tick has come."""
        self._due = None
        following = next(self._ahead, None)
        if following is None:
            self.finished = True
            self.controller.release()
            self._tell(Phase.DONE)
            return
        before = self._segment
        # If a trial has ended early, everything that follows is brought forward.
        segment = self._enter(replace(following, first=self.tick))
        self.tau_delta[:] = 0.0
        if self.tick and before.tare:
            self._tare = self._parameters.tare.of(self._at_rest)
            if refusal := self._parameters.tare.refusal(self._tare, self._parameters.joints):
                self.stop(Cause.TARE, refusal)
                return
            self.controller.tare(self._tare.offset)
            self.controller.perturb_joint(segment.joint)
            return
        if segment.phase is Phase.SETTLE:
            self._prepare(segment)
        elif segment.phase is Phase.PERTURB:
            self._start_ns = stamp_ns
        self._tell(segment.phase)

    def _enter(self, segment: Segment) -> Segment:
        self._segment, self._until = segment, segment.end
        return segment

    def _prepare(self, settle: Segment) -> None:
        self.controller.perturb_joint(NO_JOINT if settle.tare else settle.joint)
        self._tare = None
        self._start_ns = None
        self._saturation = SaturationCounter()
        self.lost = 0
        self._ticks = self._planned
        made = self._signals.get(settle.joint)
        self._signal = self._make_signal(settle.joint) if made is None else made

    def _make_signal(self, joint: int) -> FloatArray:
        return self._parameters.signal(joint, trial=joint + 1, ticks=self._planned)

    def _control(self, theta: Sequence[float], tau_h: Sequence[float]) -> None:
        segment = self._segment
        place: int | None = None  # within the perturbation
        # All other values of the perturbation were set to zero when the phase began.
        if not self.finished and segment.phase is Phase.PERTURB:
            place = self.tick - segment.first
            self.tau_delta[segment.joint] = self._signal[place]
        elif not self.finished and segment.tare:
            self._at_rest[:, self.tick - segment.first] = tau_h
        self._fill(*theta, *tau_h)
        clipped = self._compute()
        if clipped and place is not None:
            self._saturation.add(place, clipped)
        if not self.finished and self.controller.stopped:
            self._end(*self.controller.fault)

    def _tell(self, phase: Phase) -> None:
        segment = self._segment
        cause, reason = self.cause, self.fault
        if self.lost and cause is Cause.NONE:
            what = "sample" if self.lost == 1 else "samples"
            cause, reason = Cause.SAMPLES_LOST, f"{self.lost} {what} did not arrive"
        self._announce(
            TrialStatus(
                phase=phase,
                trial=segment.trial,
                trials=len(self._parameters.joints),
                joint=segment.joint,
                joint_name=self._parameters.joints[segment.joint],
                tick=self.tick,
                start_ns=self._start_ns,
                ticks=self._ticks,
                seed=self._parameters.seed,
                valid=cause is Cause.NONE,
                cause=cause,
                reason=reason,
                lost=self.lost,
                clipped=self._saturation.clipped,
                clipped_intervals=self._saturation.text,
                tare=() if self._tare is None else self._tare.offset,
                tare_error=() if self._tare is None else self._tare.error,
            )
        )


class SamplePairs:
    """Pairs by stamp the two readings of a sample, which come as separate messages."""

    def __init__(self) -> None:
        self._waiting: dict[int, tuple[int, Reading]] = {}

    def other(self, kind: int, stamp_ns: int, values: Reading) -> Reading | None:
        """Take a position (kind 0) or torque (1); return the other of that stamp (ns), or None."""
        waiting = self._waiting
        other = waiting.pop(stamp_ns, None)
        if other is None or other[0] == kind:
            waiting[stamp_ns] = kind, values
            if len(waiting) > _MOST_WAITING:  # the others do not come at all
                del waiting[next(iter(waiting))]
            return None
        if waiting:
            # Older readings without a partner are lost samples, which the sequencer counts.
            for old in [stamp for stamp in waiting if stamp < stamp_ns]:
                del waiting[old]
        return other[1]


class Watchdog:
    """Detects that samples no longer come, and says how far the ramp to zero has to be by now.

    The caller passes the time of any monotonic clock (s), so tests need not wait.

    Parameters
    ----------
    safety : SafetyParameters
    slowest_tick : longest wall time that may count as one period, s
    """

    def __init__(self, safety: SafetyParameters, *, slowest_tick: float) -> None:
        self._patience = safety.watchdog_ticks * slowest_tick
        self._longest = safety.ramp_ticks
        self._last = math.inf  # no sample yet
        self._given = 0

    def feed(self, now: float) -> None:
        """Note that a sample came at the time ``now``, s."""
        self._last = now
        self._given = 0

    def expired(self, now: float) -> bool:
        """Whether samples have stayed away for too long (never before the first one)."""
        return not now - self._last < self._patience

    def ticks_due(self, now: float) -> int:
        """Return the ticks of the ramp that have become due since the last call.

        To be called once the patience has ended: then the first is due. If ``now`` is NaN, all are.
        """
        overdue = (now - self._last - self._patience) / PERIOD
        due = int(overdue) + 1 if overdue < self._longest else self._longest
        new = max(due - self._given, 0)
        self._given = max(due, self._given)
        return new
