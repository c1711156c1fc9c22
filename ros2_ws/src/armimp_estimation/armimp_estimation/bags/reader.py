"""Reading of bags, recorded here or elsewhere, into trials and messages."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armimp_common import topics
from armimp_common.cdr import joint_names_of
from armimp_common.errors import BagError, ConfigurationError, DataError, MalformedMessageError
from armimp_common.status import TrialStatus
from armimp_estimation.alignment.assemble import Trial, assemble_trials
from armimp_estimation.alignment.streams import decode_streams
from armimp_estimation.bags.files import read_storage
from armimp_estimation.bags.raw import RawMessages, one_line
from armimp_estimation.bags.statuses import decode_trial_statuses
from armimp_estimation.bags.topics import contract_topic, require_topics, resolve_topics

_MOST_JOINTS: Final = 100
_MOST_STATUSES: Final = 20_000
"""A trial has four, and one more for each thing that goes wrong in it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BagContent:
    """What a bag holds."""

    path: Path
    """The bag."""
    metadata: Mapping[str, str]
    """Metadata of the recording; empty for bags recorded elsewhere."""
    joint_names: tuple[str, ...]
    """Order of the joints in the records."""
    trials: tuple[Trial, ...]
    """At least one; each says whether it can be estimated."""
    topics: Mapping[str, str]
    """Name in the bag of each topic of the contract that is in it."""
    notes: tuple[str, ...]
    """What a user should know of the bag, one line each: a cut, damaged messages."""
    _raw: RawMessages
    _contract_names: Mapping[int, str]

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of reception (ns) and bytes of each message of the contract, in order."""
        for index, log_time_ns, payload in self._raw:
            if index in self._contract_names:
                yield self._contract_names[index], log_time_ns, payload


def read_bag(path: Path, *, namespace: str | None = None, trust: bool = False) -> BagContent:
    """Read a bag with everything that an estimate needs.

    Taken are rosbag2 directories with complete, provisional or no ``metadata.yaml``, and single
    MCAP or SQLite3 files, compressed or not, complete or cut. Topics may be under a namespace, and
    the joints of every message in any order, with further ones in those of sensors. Where there is
    no trial status, the trials are inferred from the perturbation, as `infer_windows` says.

    Parameters
    ----------
    path : Path
        Directory or file.
    namespace : str, optional
        Of the topics, where a bag holds those of several rigs.
    trust : bool
        Whether to lift the limits on what a bag may hold, which grow with its size.

    Raises
    ------
    BagError
        If the path is not a readable bag, or the bag lacks something; the message is one line
        that names the file. A trial that is there but spoiled raises only where it is estimated.
    """
    raw = read_storage(path, contract_topic, trust=trust)
    if not raw.payloads:
        cut = f"; the file {raw.cut}" if raw.cut else ""
        raise BagError(f"{path}: no messages of an experiment in it{cut}")
    found = resolve_topics(raw.topics, bag=str(path), namespace=namespace)
    require_topics(found, bag=str(path))
    by_index = raw.by_topic()
    messages = {
        topic: by_index.get(found[topic], []) if topic in found else []
        for topic in (*topics.DATA_STREAMS, topics.TRIAL)
    }
    if len(messages[topics.TRIAL]) > _MOST_STATUSES and not trust:
        raise raw.refusal(f"has {len(messages[topics.TRIAL])} messages of {topics.TRIAL}")
    statuses, defect = decode_trial_statuses(messages[topics.TRIAL])
    try:
        joint_names = _joint_names(raw.metadata, messages[topics.PERTURBATION])
        if len(joint_names) > _MOST_JOINTS:
            raise DataError(f"{len(joint_names)} joints are more than {_MOST_JOINTS}")
        streams = decode_streams(joint_names, messages)
        trials = assemble_trials(streams, statuses, source=str(path))
    except (DataError, ConfigurationError, MalformedMessageError) as error:
        cut = f" (the file {raw.cut})" if raw.cut else ""
        raise BagError(f"{path}: {one_line(error)}{cut}") from None
    if not trials:
        raise BagError(f"{path}: no trial in it; {_last_words(statuses)}")
    notes = [f"{path}: {raw.cut}"] if raw.cut else []
    if defect:
        notes.append(f"{path}: damaged messages of {topics.TRIAL}: {one_line(defect)}")
    notes += [f"{path}: {trial.note}" for trial in trials if trial.note]
    for topic in (topics.JOINT_STATES, topics.TORQUE_SENSORS):
        # Something could be decoded, but it need not be the first message.
        with suppress(MalformedMessageError):
            others = set(joint_names_of(messages[topic][0])).difference(joint_names)
            if others:
                passed_over = f"{path}: {topic} has joints that were passed over"
                listed = one_line(", ".join(sorted(others)))
                notes.append(f"{passed_over}, {listed}: they must not have moved")
    return BagContent(
        path=path,
        metadata=raw.metadata,
        joint_names=joint_names,
        trials=trials,
        topics={topic: raw.topics[index][0] for topic, index in found.items()},
        notes=tuple(notes),
        _raw=raw,
        _contract_names={index: topic for topic, index in found.items()},
    )


def _joint_names(metadata: Mapping[str, str], perturbation: Sequence[bytes]) -> tuple[str, ...]:
    """Joint order: that of the recording's metadata, else that of the controller."""
    try:
        names = json.loads(metadata.get("joint_names", "null"))
    except (ValueError, RecursionError):
        names = None
    if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
        return tuple(names)
    defect: MalformedMessageError | None = None
    for message in perturbation:
        try:
            return joint_names_of(message)
        except MalformedMessageError as error:
            defect = defect or error
    raise defect or DataError(f"no messages of {topics.PERTURBATION}")


def _last_words(statuses: Sequence[TrialStatus]) -> str:
    return f"the last status is: {one_line(statuses[-1].sentence)}"
