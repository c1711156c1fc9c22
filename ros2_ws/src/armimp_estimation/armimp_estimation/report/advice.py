"""What to do about a problem, by its code."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from armimp_estimation.problems import ProblemCode


@dataclass(frozen=True, kw_only=True)
class Advice:
    """A kind of problem.

    Attributes
    ----------
    title : str
        The kind in plain words.
    codes : frozenset of ProblemCode
        Problems of its kind.
    text : str
        What it means and what to do about it.
    """

    title: str
    codes: frozenset[ProblemCode]
    text: str


ADVICE = (
    Advice(
        title="Joints that should have been held still moved",
        codes=frozenset({ProblemCode.LOCK_RATIO, ProblemCode.LOCK_BIAS}),
        text=(
            "The method needs all joints but one at rest: what they move leaks into the elements "
            "of their row. Make the robot hold them harder (target.lock_frequency), check that "
            "friction is cancelled (law.gamma, law.model_inertia), that no command was clipped, "
            "and on a rig that straps and brakes are tight. The estimators with the full matrix "
            "tolerate some motion, the single-input one does not."
        ),
    ),
    Advice(
        title="A joint does not answer its perturbation",
        codes=frozenset({ProblemCode.NO_RESPONSE, ProblemCode.JOINT_DOES_NOT_MOVE}),
        text=(
            "What is measured is mostly something else than the answer to the perturbation. Is the "
            "joint free, are transducer and encoder connected in the right order? Otherwise "
            "perturb harder (--perturbation) or longer (--duration); friction swallows small "
            "perturbations."
        ),
    ),
    Advice(
        title="A channel is wrong",
        codes=frozenset(
            {
                ProblemCode.COMMANDS_PERMUTED,
                ProblemCode.IMPLAUSIBLE_INERTIA,
                ProblemCode.IMPLAUSIBLE_VALUE,
                ProblemCode.IMPLAUSIBLE_ANGLE,
                ProblemCode.TORQUE_UNBALANCED,
                ProblemCode.CALIBRATION_ASSUMED,
                ProblemCode.ROBOT_INERTIA_IMPOSSIBLE,
            }
        ),
        text=(
            "Numbers like these come from a sign, a unit, a gain or an order of channels. Push "
            "each joint by hand and compare the signs of angle and torque, hang a known weight on "
            "each transducer, and compare the names of joints in all streams. "
            "armimp check-driver moves one joint after the other and tells which one answers."
        ),
    ),
    Advice(
        title="A signal is clipped, stuck or too coarse",
        codes=frozenset({ProblemCode.CLIPPED, ProblemCode.STUCK, ProblemCode.UNRESOLVED}),
        text=(
            "What a transducer can't follow biases the estimate. Perturb less where it is clipped, "
            "more where it isn't resolved; look for loose contacts and for a driver that repeats "
            "its last reading."
        ),
    ),
    Advice(
        title="Times of samples are in doubt",
        codes=frozenset(
            {
                ProblemCode.RATE_UNCUSTOMARY,
                ProblemCode.RATE_UNPLANNED,
                ProblemCode.RATE_DRIFTS,
                ProblemCode.STAMPS_IRREGULAR,
                ProblemCode.STREAM_RATES_DIFFER,
                ProblemCode.DELAY_CORRECTED,
                ProblemCode.TIMING_REFUTED,
            }
        ),
        text=(
            "All frequencies, and with them M and B, follow from the rate that the stamps give. "
            "Stamp samples when they are taken, by one clock. Declare an unusual rate (--rate)."
        ),
    ),
    Advice(
        title="The impedance is not that of inertia, viscosity and stiffness",
        codes=frozenset(
            {
                ProblemCode.LACK_OF_FIT,
                ProblemCode.MODEL_OFFERED,
                ProblemCode.NO_MODEL,
                ProblemCode.DEPENDS_ON_AMPLITUDE,
                ProblemCode.DEPENDS_ON_SPEED,
                ProblemCode.CHANGES_OVER_TIME,
            }
        ),
        text=(
            "The impedance may be right, but M, B and K do not describe it over the whole band. "
            "Reflexes, a soft cuff or a loose strap, and stiffness that depends on amplitude do "
            "that. Compare the Bode plots with the fit to see at which frequencies."
        ),
    ),
    Advice(
        title="Samples are missing or in disorder",
        codes=frozenset(
            {
                ProblemCode.SAMPLES_MISSING,
                ProblemCode.SAMPLES_MALFORMED,
                ProblemCode.SAMPLES_CONTRADICTORY,
                ProblemCode.SAMPLES_REPEATED,
                ProblemCode.SAMPLES_REORDERED,
                ProblemCode.SAMPLES_LOST,
                ProblemCode.STAMPS_DISAGREE,
                ProblemCode.COMMANDS_MISSING,
                ProblemCode.COMMANDS_FOREIGN,
                ProblemCode.PERTURBATIONS_FOREIGN,
                ProblemCode.MESSAGE_REFUSED,
            }
        ),
        text=(
            "Gaps are never filled, as that would bend the spectra. The table of samples below "
            "shows which stream is affected. Look for an overloaded computer or network, for a "
            "recorder that could not write fast enough, and for a second publisher of the same "
            "topic; then repeat the trial, or use its intact parts (--allow-gaps)."
        ),
    ),
    Advice(
        title="The computer was not quick or regular enough",
        codes=frozenset({ProblemCode.SAMPLES_LATE, ProblemCode.COMMANDS_LATE, ProblemCode.LATENCY}),
        text=(
            "Samples or commands came too late for 1 kHz. End other programs, give rig and "
            "controller precedence (--priority), one processor core each (realtime.cpu), and see "
            "docs/realtime.md; or run in lockstep (--mode lockstep), which needs no pace."
        ),
    ),
    Advice(
        title="Much of a trial is left out",
        codes=frozenset({ProblemCode.MUCH_EXCLUDED, ProblemCode.CLIPPED_UNKNOWN}),
        text=(
            "Samples that are missing, and those under commands that were clipped, are in no "
            "estimate; the table of samples below says how many. Raise the limits or perturb less "
            "if commands were clipped; else repeat the trial."
        ),
    ),
    Advice(
        title="Recording failed",
        codes=frozenset({ProblemCode.RECORDING_FAILED}),
        text=(
            "The bag holds what could be written. If the disk is full, make room, or take another "
            "directory (--out)."
        ),
    ),
    Advice(
        title="A signal held numbers that are not finite",
        codes=frozenset({ProblemCode.SAMPLES_NOT_FINITE}),
        text=(
            "A driver or a computation gave NaN or infinity. The time traces end, or have a gap, "
            "where it happened; repair the source and repeat the trial."
        ),
    ),
    Advice(
        title="There are too few samples",
        codes=frozenset({ProblemCode.RECORD_TOO_SHORT, ProblemCode.NOTHING_RECORDED}),
        text="Record for longer: 50 s per trial are usual, 10 s the least that makes sense.",
    ),
    Advice(
        title="The trials do not make a whole",
        codes=frozenset(
            {ProblemCode.TRIALS_INCOMPLETE, ProblemCode.JOINT_UNKNOWN, ProblemCode.NO_PERTURBATION}
        ),
        text=(
            "The matrix needs exactly one trial for each joint, in which that joint alone is "
            "perturbed, all from one arrangement of the rig. Record what is missing, or leave out "
            "what is too much."
        ),
    ),
    Advice(
        title="The run was stopped",
        codes=frozenset(
            {
                ProblemCode.TRIAL_ABORTED,
                ProblemCode.TRIAL_SPOILED,
                ProblemCode.RECORDING_STOPPED,
                ProblemCode.INTERRUPTED,
                ProblemCode.STALLED,
                ProblemCode.NODE_FAULT,
            }
        ),
        text=(
            "The sentence gives the reason. What was recorded up to then is in the bags; look at "
            "the end of the time traces (“last 2 s”) and, for separate processes, into logs/."
        ),
    ),
    Advice(
        title="A node failed",
        codes=frozenset({ProblemCode.NODE_FAILED, ProblemCode.PARAMETERS_DIFFER}),
        text=(
            "Its last words are in the sentence, and all of them in logs/ if it had a process of "
            "its own. Bags written up to then can be estimated: armimp estimate BAG…"
        ),
    ),
    Advice(
        title="Nothing could be estimated",
        codes=frozenset({ProblemCode.NOT_ESTIMATED}),
        text="The sentence gives the reason, and the time traces show the signals.",
    ),
)
"""Each code belongs to one kind."""

_KIND = {code: advice for advice in ADVICE for code in advice.codes}


def advise(problems: Iterable[tuple[ProblemCode, str]]) -> list[tuple[Advice, list[str]]]:
    """Sort problems by what there is to do about them.

    Parameters
    ----------
    problems : iterable of (ProblemCode, str)
        Code and sentence of each.

    Returns
    -------
    list of (Advice, list of str)
        Kinds in the order of the first problem of each, with the sentences of their problems.
    """
    kinds: dict[str, tuple[Advice, list[str]]] = {}
    for code, sentence in problems:
        advice = _KIND[code]
        kinds.setdefault(advice.title, (advice, []))[1].append(sentence)
    return list(kinds.values())
