"""Judgement of drivers: what is sound passes, and each planted defect is named."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from armimp_bringup.driver_check.findings import Verdict, failures, open_questions, report
from armimp_bringup.driver_check.judge import judge
from armimp_bringup.driver_check.responses import letting
from armimp_bringup.driver_check.samples import Call, Ending, Endpoint, Message, Push, Record
from armimp_bringup.driver_check.witness import stalls
from armimp_common import topics
from armimp_common.topics import COMMANDS, JOINT_STATES, PERIOD_NS, TORQUE_SENSORS
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig

JOINTS = ("shoulder", "elbow")
ZERO = (0.0, 0.0)
SAMPLES = 1000
REST, HOLD, AFTER = 200, 400, 250
Torque = tuple[float, float]
Edit = Callable[[Message], Message]


class Bench:
    """The simulated rig, with commands and readings as a bad driver would pass them on."""

    def __init__(self, drive: Callable[[Torque], Torque] = lambda torque: torque) -> None:
        self.rig = SimulatedRig(SimulatorParameters.preset())
        self.drive = drive

    def push(
        self, joint: int, end: Callable[["Bench", Torque], list[Torque]], sign: float = 1.0
    ) -> Push:
        """Let the arm settle, push a joint, then go on as `end` says."""
        torque = (1.0, 0.0) if joint == 0 else (0.0, 1.0)
        self.play([ZERO] * 1500)
        script = [ZERO] * REST + [torque] * HOLD
        position, effort = self.play(script)
        last = self.play(end(self, torque))
        return Push(
            joint=joint,
            torque=1.0,
            position=np.hstack([position, last[0]]),
            effort=sign * np.hstack([effort, last[1]]),
            on=REST,
            off=REST + HOLD - 1,
        )

    def play(self, script: list[Torque]) -> tuple[np.ndarray, np.ndarray]:
        position, effort = [], []
        for torque in script:
            position.append(self.rig.position.copy())
            effort.append(self.rig.torque.copy())
            self.rig.step(self.drive(torque))
        return np.array(position).T, np.array(effort).T


def release(bench: Bench, torque: Torque) -> list[Torque]:
    return [ZERO] * AFTER


def hold(bench: Bench, torque: Torque) -> list[Torque]:
    return [torque] * (HOLD + AFTER)


def ramp(wait: int, length: int) -> Callable[[Bench, Torque], list[Torque]]:
    """What a driver makes of silence: it waits, then goes to zero in a straight line."""

    def script(bench: Bench, torque: Torque) -> list[Torque]:
        shares = [1.0] * wait + [(length - 1 - i) / length for i in range(length)]
        fall = [(share * torque[0], share * torque[1]) for share in shares]
        return fall + [ZERO] * AFTER

    return script


def pushes(bench: Bench, sign: float = 1.0) -> list[Push]:
    return [bench.push(joint, release, sign) for joint in range(2)]


def ending(bench: Bench, end: Callable[[Bench, Torque], list[Torque]]) -> Ending:
    bench.push(0, release)
    released, held = bench.push(0, release), bench.push(0, hold)
    return Ending(
        push=bench.push(0, end),
        released=released,
        held=held,
        told=0.02,
        reset=Call(success=True),
    )


def renewed(bench: Bench, share: float = 0.0) -> Push:
    """Torque that is commanded anew after a fault, of which a share acts."""
    bench.play([ZERO] * 500)
    position, effort = bench.play([ZERO] * REST + [(share, 0.0)] * REST)
    last = bench.play([ZERO] * AFTER)
    return Push(
        joint=0,
        torque=1.0,
        position=np.hstack([position, last[0]]),
        effort=np.hstack([effort, last[1]]),
        on=REST,
        off=2 * REST - 1,
    )


def messages(topic: str, edit: Edit = lambda message: message) -> list[Message]:
    """A second of a sound stream, with readings that change by a count now and then."""
    rng = np.random.default_rng(7)
    step = 2.0 * np.pi / 51200 if topic == JOINT_STATES else 0.02
    centre = (1.09, 1.35) if topic == JOINT_STATES else (0.0, 0.0)
    found = []
    for tick in range(SAMPLES):
        counts = np.rint(np.array(centre) / step) + rng.integers(-1, 2, 2)
        values = tuple((counts * step).tolist())
        found.append(
            edit(
                Message(
                    arrival_ns=10**12 + tick * PERIOD_NS + int(rng.integers(0, 50_000)),
                    stamp_ns=tick * PERIOD_NS,
                    names=JOINTS,
                    position=values if topic == JOINT_STATES else (),
                    effort=values if topic == TORQUE_SENSORS else (),
                )
            )
        )
    return found


def endpoint(topic: str) -> Endpoint:
    return Endpoint(
        topic=topic,
        role="subscriber" if topic == COMMANDS else "publisher",
        node="/arm_sim",
        type=topics.MESSAGE_TYPES[topic],
    )


@pytest.fixture(scope="module")
def sound() -> Record:
    bench = Bench()
    silence = replace(ending(bench, ramp(5, 10)), again=renewed(bench))
    stop = ending(bench, lambda bench, torque: [ZERO] * AFTER)
    return Record(
        joints=JOINTS,
        paced=True,
        endpoints=[endpoint(topic) for topic in (JOINT_STATES, TORQUE_SENSORS, COMMANDS)],
        streams={topic: messages(topic) for topic in (JOINT_STATES, TORQUE_SENSORS)},
        services=frozenset({topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE}),
        lifecycle="unconfigured",
        pushes=pushes(bench),
        moved=0.002,
        most=0.3,
        stale=silence,
        stop=replace(stop, stop=Call(success=True, seconds=0.01)),
        second=Ending(push=None, told=0.02, reset=Call(success=True)),
    )


def edited(record: Record, topic: str, edit: Edit) -> Record:
    return replace(record, streams={**record.streams, topic: messages(topic, edit)})


def test_a_sound_driver_passes(sound: Record) -> None:
    findings = judge(sound)

    assert failures(findings) == []
    left = {f.check for f in findings if f.verdict is Verdict.NOT_CHECKED}
    depths = {f"{topic}: depth" for topic in (JOINT_STATES, TORQUE_SENSORS, COMMANDS)}
    assert left == {*depths, "sample to command"}
    assert report(findings)["passed"] is True


def _nan(message: Message) -> Message:
    spoiled = message.stamp_ns == 500 * PERIOD_NS
    return replace(message, effort=(float("nan"), 0.0)) if spoiled else message


def _backwards(message: Message) -> Message:
    return replace(message, stamp_ns=message.stamp_ns - 2 * PERIOD_NS * (message.stamp_ns > 10**8))


def _held_up(message: Message) -> Message:
    late = message.stamp_ns // PERIOD_NS % 20 == 3
    return replace(message, arrival_ns=message.arrival_ns + 600_000 * late)


@pytest.mark.parametrize(
    ("topic", "edit", "named"),
    [
        (JOINT_STATES, lambda m: replace(m, names=("shoulder", "wrist")), "joint names"),
        (JOINT_STATES, lambda m: replace(m, names=("elbow", "elbow")), "joint names"),
        (
            JOINT_STATES,
            lambda m: replace(m, position=tuple(np.degrees(m.position).tolist())),
            "range",
        ),
        (JOINT_STATES, lambda m: replace(m, position=m.position[:1]), "field"),
        (TORQUE_SENSORS, lambda m: replace(m, position=m.effort, effort=()), "field"),
        (TORQUE_SENSORS, lambda m: replace(m, effort=tuple(1e3 * v for v in m.effort)), None),
        (TORQUE_SENSORS, _nan, "finite"),
        (JOINT_STATES, lambda m: replace(m, stamp_ns=0), "stamps increase"),
        (JOINT_STATES, _backwards, "stamps increase"),
        (JOINT_STATES, lambda m: replace(m, stamp_ns=m.stamp_ns * 1001 // 1000), "clock"),
        (JOINT_STATES, _held_up, "jitter"),
    ],
    ids=[
        "unknown joint",
        "doubled joint",
        "degrees",
        "too few values",
        "torque in position",
        "millinewton metres",
        "NaN",
        "stamps stand still",
        "stamps go back",
        "fast clock",
        "jitter",
    ],
)
def test_each_defect_of_a_stream_is_named(
    sound: Record, topic: str, edit: Edit, named: str | None
) -> None:
    failed = failures(judge(edited(replace(sound, pushes=()), topic, edit)))
    expected = f"{topic}: {'resolution' if named is None else named}"
    assert expected in failed


def test_when_samples_come_at_half_the_rate_expect_rate_and_stamps_named(sound: Record) -> None:
    slow = {topic: kept[::2] for topic, kept in sound.streams.items()}
    failed = failures(judge(replace(sound, streams=slow)))
    for topic in (JOINT_STATES, TORQUE_SENSORS):
        assert {f"{topic}: rate", f"{topic}: stamps 1 ms apart", f"{topic}: clock"} <= set(failed)


def test_when_a_sample_comes_twice_expect_it_named(sound: Record) -> None:
    kept = list(sound.streams[JOINT_STATES])
    doubled = {**sound.streams, JOINT_STATES: [*kept[:500], kept[499], *kept[500:]]}
    failed = failures(judge(replace(sound, streams=doubled)))
    assert f"{JOINT_STATES}: doubled samples" in failed


def test_when_the_stamps_of_a_pair_differ_expect_that_named_alone(sound: Record) -> None:
    shifted = edited(sound, TORQUE_SENSORS, lambda m: replace(m, stamp_ns=m.stamp_ns + 1000))
    assert failures(judge(shifted)) == ["pairs"]


def test_when_torque_sensors_are_missing_expect_type_messages_and_pairs_named(
    sound: Record,
) -> None:
    ends = [end for end in sound.endpoints if end.topic != TORQUE_SENSORS]
    streams = {JOINT_STATES: sound.streams[JOINT_STATES]}
    failed = failures(judge(replace(sound, endpoints=ends, streams=streams)))
    assert failed == [f"{TORQUE_SENSORS}: type", f"{TORQUE_SENSORS}: messages", "pairs"]


def test_wrong_types_and_qualities_of_service_are_named(sound: Record) -> None:
    ends = {end.topic: end for end in sound.endpoints}
    ends[JOINT_STATES] = replace(ends[JOINT_STATES], type="std_msgs/msg/Float64MultiArray")
    ends[TORQUE_SENSORS] = replace(ends[TORQUE_SENSORS], reliable=False, depth=10)
    failed = failures(judge(replace(sound, endpoints=list(ends.values()))))
    assert failed == [
        f"{JOINT_STATES}: type",
        f"{TORQUE_SENSORS}: quality of service",
        f"{TORQUE_SENSORS}: depth",
    ]


def test_another_order_of_names_passes_only_if_commands_were_seen_to_obey(sound: Record) -> None:
    other = edited(
        sound,
        JOINT_STATES,
        lambda m: replace(m, names=m.names[::-1], position=m.position[::-1]),
    )
    check = f"{JOINT_STATES}: joint order"
    for record, verdict in (
        (other, Verdict.PASS),
        (replace(other, pushes=()), Verdict.NOT_CHECKED),
    ):
        assert {f.check: f.verdict for f in judge(record)}[check] is verdict


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        (lambda torque: (-torque[0], torque[1]), "shoulder turns against its torque"),
        (lambda torque: (torque[1], torque[0]), "shoulder and elbow mixed up"),
    ],
    ids=["sign", "order"],
)
def test_commands_with_a_wrong_sign_or_order_are_named(
    sound: Record, drive: Callable[[Torque], Torque], words: str
) -> None:
    findings = judge(replace(sound, pushes=pushes(Bench(drive))))
    (found,) = [f for f in findings if f.check == "torque: joint and sign"]
    assert found.verdict is Verdict.FAIL
    assert words in found.figure


def test_commands_and_transducers_are_told_apart_where_signs_are_wrong(sound: Record) -> None:
    def turned(torque: Torque) -> Torque:
        return (-torque[0], -torque[1])

    for sign, more in ((1.0, []), (-1.0, ["torque_sensors: sign"])):
        failed = failures(judge(replace(sound, pushes=pushes(Bench(turned), sign=sign))))
        assert failed == ["torque: joint and sign", *more]


def test_transducers_with_a_wrong_sign_are_named(sound: Record) -> None:
    failed = failures(judge(replace(sound, pushes=pushes(Bench(), sign=-1.0))))
    assert failed == ["torque_sensors: sign"]


@pytest.mark.parametrize(
    ("wait", "length", "good"),
    [(0, 1, True), (5, 10, True), (5, 40, True), (150, 1, False), (90, 40, False)],
)
def test_the_end_of_torque_is_judged_by_motion_alone(
    sound: Record, wait: int, length: int, good: bool
) -> None:
    stale = replace(ending(Bench(), ramp(wait, length)), again=renewed(Bench()))
    failed = failures(judge(replace(sound, stale=stale)))
    assert failed == ([] if good else ["stale commands"])


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_when_torque_stays_after_stale_commands_or_a_stop_expect_both_named(
    sound: Record, share: float
) -> None:
    kept = ending(Bench(), lambda _, torque: [(share * torque[0], share * torque[1])] * AFTER)
    mute = replace(kept, told=None, stop=Call(success=True, seconds=0.01))
    failed = failures(judge(replace(sound, stale=kept, stop=mute)))
    assert failed == ["stale commands", "emergency stop", "emergency stop: told"]


def test_a_driver_that_bears_a_second_publisher_is_named(sound: Record) -> None:
    borne = Ending(push=None, told=None, reset=Call(success=True))
    assert failures(judge(replace(sound, second=borne))) == ["second publisher: told"]


def test_missing_or_silent_services_are_named(sound: Record) -> None:
    silent = Ending(push=None, told=None, stop=Call(success=None))
    failed = failures(judge(replace(sound, services=frozenset(), stop=silent)))
    assert failed == [
        f"service {topics.SIM_STOP_SERVICE}",
        f"service {topics.SIM_RESET_SERVICE}",
        "emergency stop: answer",
    ]


@pytest.mark.parametrize("friction", [1, 2, 3])
@pytest.mark.parametrize("joint", [0, 1])
def test_the_moment_at_which_torque_has_gone_is_found_within_ten_milliseconds(
    friction: int, joint: int
) -> None:
    bench = Bench()
    bench.rig = SimulatedRig(SimulatorParameters.preset(friction=friction))
    bench.push(joint, release)
    released, held = bench.push(joint, release), bench.push(joint, hold)
    for wait, length in ((0, 1), (5, 10), (5, 30)):
        found = letting(bench.push(joint, ramp(wait, length)), released, held)
        assert found is not None
        assert found.share >= 0.65
        assert abs(found.delay - (wait + length - 1)) <= 10


def test_nothing_is_judged_by_motion_where_nothing_moved(sound: Record) -> None:
    still = [
        replace(push, position=0 * push.position, effort=0 * push.effort) for push in sound.pushes
    ]
    findings = {f.check: f.verdict for f in judge(replace(sound, pushes=still))}
    for check in ("torque: joint and sign", "torque_sensors: sign", "torque: delay"):
        assert findings[check] is Verdict.INCONCLUSIVE


def test_when_torque_acts_again_before_the_reset_expect_that_named_alone(sound: Record) -> None:
    assert sound.stale is not None
    for share, named in ((1.0, ["stale commands: latched"]), (0.0, [])):
        stale = replace(sound.stale, again=renewed(Bench(), share))
        assert failures(judge(replace(sound, stale=stale))) == named


def given_up(sound: Record, **changes: object) -> Record:
    given: dict[str, object] = {"pushes": (), "stale": None, "stop": None, **changes}
    return replace(sound, **given)  # type: ignore[arg-type]


def test_when_the_rig_moved_too_far_expect_motion_named_and_the_rest_inconclusive(
    sound: Record,
) -> None:
    reason = "elbow went 0.31 rad from where it was: torque taken away"
    findings = judge(given_up(sound, broken=reason))
    assert failures(findings) == ["torque: motion"]
    assert {"torque: joint and sign", "stale commands", "emergency stop"} <= set(
        open_questions(findings)
    )


def test_when_a_driver_stops_under_regular_commands_expect_that_named(sound: Record) -> None:
    words = "arm_sim: rig: no command for 5 periods"
    findings = judge(given_up(sound, broken=f"the driver stopped: {words}", stopped=words))
    assert failures(findings) == ["torque: no stop"]
    assert {"torque: delay", "stale commands"} <= set(open_questions(findings))


def test_when_the_machine_held_up_all_attempts_expect_no_verdict_on_the_driver(
    sound: Record,
) -> None:
    broken = "commands were held up 8 times, by up to 12 ms"
    findings = judge(given_up(sound, broken=broken, repeated=8, gap=0.012))
    assert failures(findings) == []
    assert {"torque: no stop", "torque: delay", "emergency stop"} <= set(open_questions(findings))
    assert not report(findings)["passed"]


def test_a_fault_at_rest_is_named_and_what_was_asked_for_in_vain_is_inconclusive(
    sound: Record,
) -> None:
    fault = "arm_sim: rig: emergency stop"
    record = given_up(
        sound, moved=None, faults=[fault], troubled=True, skipped=f"there is a fault: {fault}"
    )
    findings = judge(record)
    assert failures(findings) == ["no fault at rest"]
    assert "torque: delay" in open_questions(findings)
    # Without --move nothing was asked for.
    findings = judge(replace(record, troubled=False, skipped="not without --move"))
    assert open_questions(findings) == []


def test_jitter_is_the_drivers_only_where_the_checker_was_awake(sound: Record) -> None:
    record = edited(sound, JOINT_STATES, _held_up)
    late = [m.stamp_ns for m in record.streams[JOINT_STATES] if m.stamp_ns // PERIOD_NS % 20 == 3]
    asleep = [(10**12 + stamp - 100_000, 10**12 + stamp + 500_000) for stamp in late]
    check = f"{JOINT_STATES}: jitter"
    for found, verdict in (
        ([], Verdict.FAIL),
        (asleep[: len(asleep) // 2], Verdict.FAIL),
        (asleep, Verdict.INCONCLUSIVE),
    ):
        judged = judge(replace(record, stalls=stalls(found, 10**9)))
        assert {f.check: f.verdict for f in judged}[check] is verdict


@pytest.mark.parametrize(
    ("waited", "verdict"), [(0.001, Verdict.FAIL), (0.05, Verdict.INCONCLUSIVE)]
)
def test_jitter_is_not_the_drivers_where_it_waited_for_a_processor(
    sound: Record, waited: float, verdict: Verdict
) -> None:
    record = replace(edited(sound, JOINT_STATES, _held_up), waited=waited)
    check = f"{JOINT_STATES}: jitter"
    assert {f.check: f.verdict for f in judge(record)}[check] is verdict


@pytest.mark.parametrize(
    ("slower", "stall_ns", "verdict"),
    [
        (1.003, 0, Verdict.PASS),
        (1.015, 1_000_000, Verdict.FAIL),
        (1.015, 20_000_000, Verdict.INCONCLUSIVE),
        (2.0, 20_000_000, Verdict.FAIL),
    ],
)
def test_a_wrong_rate_is_the_drivers_unless_a_stall_of_the_checker_explains_it(
    sound: Record, slower: float, stall_ns: int, verdict: Verdict
) -> None:
    record = edited(
        sound,
        JOINT_STATES,
        lambda m: replace(m, arrival_ns=10**12 + round(slower * (m.arrival_ns - 10**12))),
    )
    found = stalls([(10**12, 10**12 + stall_ns)] if stall_ns else [], 10**9)
    check = f"{JOINT_STATES}: rate"
    assert {f.check: f.verdict for f in judge(replace(record, stalls=found))}[check] is verdict


def test_a_single_stall_at_the_end_of_a_recording_is_no_wrong_rate(sound: Record) -> None:
    kept = list(sound.streams[JOINT_STATES])
    late = [
        replace(m, arrival_ns=m.arrival_ns + 30_000_000 - i * 900_000)
        for i, m in enumerate(kept[-30:])
    ]
    record = replace(sound, streams={**sound.streams, JOINT_STATES: [*kept[:-30], *late]})
    assert f"{JOINT_STATES}: rate" not in failures(judge(record))


def test_a_quick_motion_that_leaves_levels_out_says_nothing_of_the_resolution(
    sound: Record,
) -> None:
    count = 2.0 * np.pi / 51200
    check = f"{JOINT_STATES}: resolution"
    for levels, verdict in (
        ((0, 3, 8, 15), Verdict.NOT_CHECKED),
        ((0, 4, 8, 12), Verdict.FAIL),
        ((0, 3, 8, 9), Verdict.PASS),
    ):

        def edit(m: Message, levels: tuple[int, ...] = levels) -> Message:
            angle = count * levels[min(m.stamp_ns // PERIOD_NS // 50, 3)]
            return replace(m, position=(angle, 0.0))

        found = judge(edited(sound, JOINT_STATES, edit))
        assert {f.check: f.verdict for f in found}[check] is verdict
