"""What to do about a problem.

Problems come as sentences, from `armimp_estimation.verdict`, the assembly of trials, the controller
and the orchestrator. The tests hold the patterns against the sentences of the first two.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Advice:
    """A kind of problem.

    Attributes
    ----------
    title : str
        The kind in plain words.
    pattern : str
        Regular expression that is found in the sentences of its kind.
    text : str
        What it means and what to do about it.
    """

    title: str
    pattern: str
    text: str


ADVICE = (
    Advice(
        title="Joints that should have been held still moved",
        pattern=r"was not held still|motion of .* explains",
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
        pattern=r"does not follow|does not move|linearly dependent",
        text=(
            "What is measured is mostly something else than the answer to the perturbation. Is the "
            "joint free, are transducer and encoder connected in the right order? Otherwise "
            "perturb harder (--perturbation) or longer (--duration); friction swallows small "
            "perturbations."
        ),
    ),
    Advice(
        title="A channel is wrong",
        pattern=(
            r"not that of a passive arm|outside of what an arm|can't be radians|its command "
            r"disagree|commands less torques move"
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
        pattern=r"is clipped at|is stuck: |counts of its resolution",
        text=(
            "What a transducer can't follow biases the estimate. Perturb less where it is clipped, "
            "more where it isn't resolved; look for loose contacts and for a driver that repeats "
            "its last reading."
        ),
    ),
    Advice(
        title="The sampling rate is in doubt",
        pattern=r"stamps give|sampling rate drifts|stamps are irregular|stamps of .* give",
        text=(
            "All frequencies, and with them M and B, follow from the rate that the stamps give. "
            "Stamp samples when they are taken, by one clock. Declare an unusual rate (--rate)."
        ),
    ),
    Advice(
        title="The impedance is not that of inertia, viscosity and stiffness",
        pattern=r"is not of the form M s²|the stiffness of |proportion to its speed",
        text=(
            "The impedance may be right, but M, B and K do not describe it over the whole band. "
            "Reflexes, a soft cuff or a loose strap, and stiffness that depends on amplitude do "
            "that. Compare the Bode plots with the fit to see at which frequencies."
        ),
    ),
    Advice(
        title="Samples are missing or in disorder",
        pattern=(
            r"(is|are) missing (at|in|between) |came (more than once|out of order)|"
            r"stamps do not agree|did not arrive|no sensor sample|must move forward|"
            r"malformed"
        ),
        text=(
            "Gaps are never filled, as that would bend the spectra. The ledger below shows which "
            "stream is affected. Look for an overloaded computer or network, for a recorder that "
            "could not write fast enough, and for a second publisher of the same topic; then "
            "repeat the trial, or use its intact parts (--allow-gaps)."
        ),
    ),
    Advice(
        title="The computer was not quick or regular enough",
        pattern=r"^real time: |no command for \d+ ticks|ticks behind",
        text=(
            "Samples or commands came too late for 1 kHz. End other programs, give rig and "
            "controller precedence (--priority), one processor core each (realtime.cpu), and see "
            "docs/realtime.md; or run in lockstep (--mode lockstep), which needs no pace."
        ),
    ),
    Advice(
        title="Much of a trial is left out",
        pattern=r"of its samples are excluded|commands were clipped",
        text=(
            "Samples that are missing, and those under commands that were clipped, are in no "
            "estimate; the ledger below says how many. Raise the limits or perturb less if "
            "commands were clipped; else repeat the trial."
        ),
    ),
    Advice(
        title="There is no room on the disk",
        pattern=r"disk full|of disk space needed",
        text="The bag holds what fitted. Make room, or take another directory (--out).",
    ),
    Advice(
        title="A signal held numbers that are not finite",
        pattern=r"not finite",
        text=(
            "A driver or a computation gave NaN or infinity. The time traces end, or have a gap, "
            "where it happened; repair the source and repeat the trial."
        ),
    ),
    Advice(
        title="There are too few samples",
        pattern=r"shorter than one segment|no measure of noise|too few to fit|no samples of it",
        text="Record for longer: 50 s per trial are usual, 10 s the least that makes sense.",
    ),
    Advice(
        title="The trials do not make a whole",
        pattern=(
            r"no trial (perturbs|to estimate)|trials perturb joint|perturbs .* as well as|"
            r"perturbed at once|perturbed joint is not among|has joints|samples per second|"
            r"spectra at different|no joint is perturbed|perturbation is zero|no perturbation at"
        ),
        text=(
            "The matrix needs exactly one trial for each joint, in which that joint alone is "
            "perturbed, all from one arrangement of the rig. Record what is missing, or leave out "
            "what is too much."
        ),
    ),
    Advice(
        title="The run was stopped",
        pattern=r"aborted|interrupted|watchdog|nothing happened|nobody (publishes|at the other)",
        text=(
            "The sentence gives the reason. What was recorded up to then is in the bags; look at "
            "the end of the time traces (“last 2 s”) and, for separate processes, into logs/."
        ),
    ),
    Advice(
        title="A node failed",
        pattern=r"^node |did not appear|did not answer|failed to|not managed",
        text=(
            "Its last words are in the sentence, and all of them in logs/ if it had a process of "
            "its own. Bags written up to then can be estimated: armimp estimate BAG…"
        ),
    ),
)
OTHER = Advice(title="Other problems", pattern="", text="")


def advise(problems: Iterable[str]) -> list[tuple[Advice, list[str]]]:
    """Sort problems by what there is to do about them.

    Returns
    -------
    list of (Advice, list of str)
        In the order of the first problem of each kind.
    """
    kinds: dict[str, tuple[Advice, list[str]]] = {}
    for problem in problems:
        advice = next((one for one in ADVICE if re.search(one.pattern, problem)), OTHER)
        kinds.setdefault(advice.title, (advice, []))[1].append(problem)
    return list(kinds.values())
