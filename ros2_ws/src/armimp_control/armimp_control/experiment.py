"""The controller without ROS: samples in, commands and perturbations out, phase after phase."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armimp_common.status import NOTICE_TICKS, Cause, Phase, StoppingDecision, TrialStatus
from armimp_common.topics import PERIOD_NS, clock_step
from armimp_control.laws.law import Controller
from armimp_control.parameters import PERIOD, ControllerParameters
from armimp_control.perturbation import perturbation
from armimp_control.safety import Limit
from armimp_control.saturation import SaturationCounter
from armimp_control.sequence import Segment, timetable
from armimp_control.tare import Tare


class Experiment:
    """Answers each sample with a command and leads through the trials.

    Parameters
    ----------
    parameters : ControllerParameters
    announce : called with every new status, before the command that it concerns

    Attributes
    ----------
    command : (n,) N·m, answer to the last sample
    tau_delta : (n,) N·m, perturbation of the last sample
    fault : why the experiment has ended early, in words; empty if it has not
    lost : number of samples that were missing between others in the present trial
    finished : whether all trials are over, in good order or not

    Raises
    ------
    ConfigurationError
        If the parameters do not fit together or the loop would be unstable.
    """

    def __init__(
        self, parameters: ControllerParameters, announce: Callable[[TrialStatus], None]
    ) -> None:
        self.margins = parameters.check()
        self._parameters = parameters
        self._announce = announce
        self._perturbation_config = parameters.perturbation_config()
        self._law = Controller(parameters.law_config(), safety=parameters.safety_config())
        n = self._joints = len(parameters.joints)
        self._segments = timetable(parameters.sequence_config(), joints=n, period=PERIOD)
        self._next_segment = 0
        self._segment: Segment | None = None
        self._until = 0  # tick with which the next segment begins
        self._ticks = self._perturbed_ticks(1)
        self._due: int | None = None
        self._start_ns: int | None = None
        self._next_ns: int | None = None  # stamp that is expected
        self._signal: NDArray[np.float64] = np.zeros(0)
        # In lockstep made when its trial begins, as memory is worth more there than time.
        self._signals = (
            {
                one.trial: self._make_signal(one)
                for one in self._segments
                if one.phase is Phase.PERTURB
            }
            if parameters.mode == "realtime"
            else {}
        )
        self._fill = partial(struct.Struct(f"{2 * n}d").pack_into, self._law.sample.data, 0)
        self._tare_config = parameters.sequence_config().tare
        # Readings while all joints are held.
        self._at_rest = np.zeros((n, self._tare_config.ticks(PERIOD)))
        self._tare: Tare | None = None
        self._tick = 0
        self._reason = self._malformed = ""
        self.command, self.tau_delta = self._law.command, self._law.sample[2]
        self._compute = self._law.compute
        self._clips = SaturationCounter()
        self.fault = ""
        self.lost = 0
        self.finished = False
        self._compile()

    def answer(self, stamp_ns: int, theta: Sequence[float], tau_h: Sequence[float]) -> None:
        """Compute :attr:`command` and :attr:`tau_delta` for one sample.

        Parameters
        ----------
        stamp_ns : of the sample, ns
        theta : (n,) encoder readings, rad
        tau_h : (n,) torque on the arm, N·m

        Notes
        -----
        A sample that is wrong in any way ends the experiment, and nothing of it is used.
        """
        if len(theta) == self._joints == len(tau_h):
            self._malformed = ""
            if not self.finished:
                if stamp_ns != self._next_ns:
                    self._check(stamp_ns)
                self._next_ns = stamp_ns + PERIOD_NS
                if self._tick >= self._until and not self.finished:
                    self._advance(stamp_ns)
            self._control(theta, tau_h)
        else:
            self._malformed = self._wrong_length(theta, tau_h)
            self.abort(self._malformed)
        self._tick += 1

    @property
    def at_rest(self) -> bool:
        """Whether the experiment is over and the torque zero."""
        return self.finished and not self.command.any()

    @property
    def tick(self) -> int:
        """Number of samples answered."""
        return self._tick

    @property
    def clips(self) -> dict[Limit, int]:
        """Number of clipped joint commands for each limit, in all phases of all trials."""
        return self._law.clips

    @property
    def present_fault(self) -> str:
        """What was wrong with the last sample, in words; else empty."""
        return self._malformed or self._law.present_fault

    @property
    def awaits_judgement(self) -> bool:
        """Whether the estimator has announced a judgement that decides on the next sample."""
        return self._due is not None and self._place >= self._due + NOTICE_TICKS

    def judge(self, judgement: StoppingDecision) -> None:
        """Take what the estimator makes of the present trial; if that is enough, end it early.

        The perturbation then ends :data:`NOTICE_TICKS` samples after those that were judged, or as
        many from now on if it is too late for that. Its end is announced at once.
        """
        segment = self._segment
        if self.finished or segment is None or segment.phase is not Phase.PERTURB:
            return
        if judgement.trial != segment.trial or judgement.samples > self._place:
            return  # it is of another experiment
        self._due = judgement.due
        end = judgement.samples + NOTICE_TICKS
        if end < self._place:
            end = self._place + NOTICE_TICKS
        if judgement.enough and end < segment.ticks:
            self._enter(replace(segment, ticks=end))
            self._ticks = end
            self._announce(self._status(Phase.PERTURB))

    @property
    def _place(self) -> int:
        """Number of samples of the present phase that were answered."""
        return 0 if self._segment is None else self._tick - self._segment.first

    def abort(self, reason: str) -> None:
        """End the experiment with zero torque at once. The first reason stays."""
        self._law.cut()
        self._end(reason)

    def stop(self, reason: str) -> None:
        """End the experiment and let the torque ramp down to zero. The first reason stays.

        The ramp takes one tick for each further answer, or those of :meth:`fall`.
        """
        self._law.stop()
        self._end(reason)

    def fall(self, ticks: int) -> None:
        """Go on with the ramp after :meth:`stop` by some ticks, where no samples come."""
        self._law.fall(ticks)

    def _end(self, reason: str) -> None:
        self.tau_delta[:] = 0.0
        self._due = None
        if self.finished:
            return
        self.finished = True
        self.fault = self._reason = reason
        self._announce(self._status(Phase.ABORTED))

    def _check(self, stamp_ns: int) -> None:
        """Check what the gate can not know: the order of the samples, and gaps between them."""
        if self._next_ns is None:
            return
        last = self._next_ns - PERIOD_NS
        if jump := clock_step(last, stamp_ns):
            self.abort(jump)
            return
        if stamp_ns <= last:
            self.abort(f"stamp {stamp_ns} ns follows {last} ns: samples must move forward")
            return
        self.lost += max(round((stamp_ns - last) / PERIOD_NS) - 1, 0)
        if self.lost:
            what = "sample" if self.lost == 1 else "samples"
            self._reason = f"{self.lost} {what} did not arrive"

    def _advance(self, stamp_ns: int) -> None:
        """Enter the next phase, whose first tick has come."""
        self._due = None
        if self._next_segment == len(self._segments):
            self.finished = True
            self._law.release()
            self._announce(self._status(Phase.DONE))
            return
        before = self._segment
        # A trial that ended early brings forward all that follows.
        segment = self._enter(replace(self._segments[self._next_segment], first=self._tick))
        self._next_segment += 1
        self.tau_delta[:] = 0.0
        if before is not None and before.tare:
            self._take_tare(segment)
            return
        if segment.phase is Phase.SETTLE:
            self._prepare(segment)
        elif segment.phase is Phase.PERTURB:
            self._start_ns = stamp_ns
        self._announce(self._status(segment.phase))

    def _enter(self, segment: Segment) -> Segment:
        self._segment, self._until = segment, segment.end
        return segment

    def _take_tare(self, settle: Segment) -> None:
        """Find the tare and let the joints take their roles, or end the experiment."""
        self._tare = self._tare_config.of(self._at_rest, PERIOD)
        if refusal := self._tare.refusal(self._tare_config, self._parameters.joints):
            self.stop(refusal)
            return
        self._law.tare(self._tare.offset)
        self._law.perturb_joint(settle.joint)

    def _prepare(self, settle: Segment) -> None:
        if settle.tare:
            self._law.lock()
        else:
            self._law.perturb_joint(settle.joint)
        self._tare = None
        self._start_ns = None
        self._reason = ""
        self._clips = SaturationCounter()
        self.lost = 0
        self._ticks = self._perturbed_ticks(settle.trial)
        made = self._signals.get(settle.trial)
        self._signal = self._make_signal(settle) if made is None else made

    def _make_signal(self, segment: Segment) -> NDArray[np.float64]:
        return perturbation(
            self._perturbation_config,
            joint=segment.joint,
            trial=segment.trial,
            ticks=self._perturbed_ticks(segment.trial),
            seed=self._parameters.seed,
        )

    def _control(self, theta: Sequence[float], tau_h: Sequence[float]) -> None:
        segment = self._segment
        place: int | None = None  # within the perturbation
        # The other joints, and all of them in other phases, were set to zero as the phase began.
        if not self.finished and segment is not None and segment.phase is Phase.PERTURB:
            place = self._tick - segment.first
            self.tau_delta[segment.joint] = self._signal[place]
        elif not self.finished and segment is not None and segment.tare:
            self._at_rest[:, self._tick - segment.first] = tau_h
        self._fill(*theta, *tau_h)
        clipped = self._compute()
        if clipped and place is not None:
            self._clips.add(place, clipped)
        if not self.finished and self._law.closed:
            self._end(self._law.fault)

    def _wrong_length(self, theta: Sequence[float], tau_h: Sequence[float]) -> str:
        for what, values in (("position", theta), ("torque reading", tau_h)):
            if len(values) != self.command.size:
                return f"{what} has {len(values)} values for {self.command.size} joints"
        return ""

    def _perturbed_ticks(self, trial: int) -> int:
        return next(
            segment.ticks
            for segment in self._segments
            if segment.trial == trial and segment.phase is Phase.PERTURB
        )

    def _status(self, phase: Phase) -> TrialStatus:
        segment = self._segment or self._segments[0]
        return TrialStatus(
            phase=phase,
            trial=segment.trial,
            trials=self._segments[-1].trial,
            joint=segment.joint,
            joint_name=self._parameters.joints[segment.joint],
            tick=self._tick,
            start_ns=self._start_ns,
            ticks=self._ticks,
            seed=self._parameters.seed,
            valid=not self._reason,
            cause=self._cause,
            reason=self._reason,
            lost=self.lost,
            clipped=self._clips.clipped,
            clipped_intervals=self._clips.text,
            tare=() if self._tare is None else self._tare.offset,
            tare_error=() if self._tare is None else self._tare.error,
        )

    @property
    def _cause(self) -> Cause:
        if self.fault:
            return Cause.OTHER
        return Cause.SAMPLES_LOST if self.lost else Cause.NONE

    def _compile(self) -> None:
        """Have the law compiled before time matters."""
        n = len(self._parameters.joints)
        self._law.perturb_joint(0)
        self._law.tick(np.zeros(n), np.zeros(n), np.zeros(n))
        self._law.stop()
        self._law.fall(1)
        self._law.reset()
