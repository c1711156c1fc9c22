"""``metadata.yaml`` of a rosbag2 directory: written as in Jazzy, read from any version."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final

import yaml
from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from armimp_common.errors import BagError
from armimp_common.schema import TextLoader, load_yaml
from armimp_common.topics import TOPICS
from armimp_estimation.atomic_write import read_text, write_text
from armimp_estimation.bags.raw import absolute, one_line
from armimp_estimation.json_model import first_complaint

FILE_NAME: Final = "metadata.yaml"
VERSION: Final = 9
"""Version of the metadata that rosbag2 writes in Jazzy."""

_ROOT: Final = "rosbag2_bagfile_information"
_INFINITE: Final = {"sec": 9223372036, "nsec": 854775807}
_MOST_BYTES: Final = 4 << 20
_DUMPER: Final[Any] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


@cache
def message_definitions() -> dict[str, dict[str, str]]:
    """Definitions of the message types of the contract in ROS 2 Jazzy, by full name.

    Each has its ``text``, followed by those of all types that it uses (encoding ``ros2msg``), and
    the RIHS01 ``hash`` of its description, by which ROS 2 compares types. They are kept in a file,
    as libraries that know all messages take a fifth of a second to import.
    """
    text = Path(__file__).with_name("message_definitions.json").read_text(encoding="utf-8")
    definitions: dict[str, dict[str, str]] = json.loads(text)
    return definitions


def qos_profiles(topic: str) -> list[dict[str, Any]]:
    """Offered QoS of the publisher of a topic of the contract, in the form of rosbag2."""
    depth, reliability, durability = TOPICS[topic].qos
    return [
        {
            "history": "keep_last",
            "depth": depth,
            "reliability": reliability,
            "durability": durability,
            "deadline": dict(_INFINITE),
            "lifespan": dict(_INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_INFINITE),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def dump(value: object) -> str:
    """Serialise a document to YAML in block style, keeping the order of its keys."""
    style: dict[str, Any] = {"sort_keys": False, "default_flow_style": False, "width": 1_000_000}
    text: str = yaml.dump(value, Dumper=_DUMPER, allow_unicode=True, **style)
    return text


def write_metadata(
    directory: Path,
    file_name: str,
    topics: Mapping[str, int],
    time_range: tuple[int, int],
    custom: Mapping[str, str],
) -> None:
    """Write ``metadata.yaml``, with its keys in the order of rosbag2.

    Parameters
    ----------
    directory : Path
        Directory of the bag.
    file_name : str
        Name of the storage file within the directory.
    topics : mapping of str to int
        Number of messages of each topic in the bag, by its name in the contract.
    time_range : tuple of int
        Earliest and latest log time of the messages (ns).
    custom : mapping of str to str
        The ``custom_data``.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    count = sum(topics.values())
    start = {"nanoseconds_since_epoch": time_range[0]}
    duration = {"nanoseconds": time_range[1] - time_range[0]}
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": dict(duration),
        "starting_time": dict(start),
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": absolute(topic),
                    "type": TOPICS[topic].type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_profiles(topic),
                    "type_description_hash": message_definitions()[TOPICS[topic].type]["hash"],
                },
                "message_count": messages,
            }
            for topic, messages in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [
            {
                "path": file_name,
                "starting_time": dict(start),
                "duration": dict(duration),
                "message_count": count,
            }
        ],
        "custom_data": dict(custom),
        "ros_distro": "jazzy",
    }
    text = dump({_ROOT: information})
    write_text(directory / FILE_NAME, text)


def read_metadata(file: Path) -> tuple[list[Path], dict[str, str]]:
    """Read storage files and custom data from a ``metadata.yaml`` of any version.

    Returns
    -------
    files : list of Path
        The storage files, in order.
    custom : dict of str to str
        The ``custom_data``; empty if there is none.

    Raises
    ------
    BagError
        If the file is not the metadata of a bag.
    """
    try:
        # Strings only: the loader must not turn unquoted text such as 12:30 into numbers.
        document = load_yaml(read_text(file, _MOST_BYTES), TextLoader, aliases=True)
        information = _Document.model_validate(document).content
    except OSError as error:
        raise BagError(f"{file}: cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        reason = first_complaint(error) if isinstance(error, ValidationError) else error
        raise BagError(f"{file}: not the metadata of a bag: {one_line(reason)}") from None
    if not information.relative_file_paths:
        raise BagError(f"{file}: lists no storage files in relative_file_paths")
    # Old versions wrote paths from the parent directory, but the files are always beside this one.
    paths = [file.parent / Path(path).name for path in information.relative_file_paths]
    return list(dict.fromkeys(paths)), information.custom_data


def _or_empty(given: object) -> object:
    return given if isinstance(given, dict) else {}  # other writers have other empty values


class _Information(BaseModel):
    """The keys of a ``metadata.yaml`` that are read."""

    relative_file_paths: list[str] = []
    custom_data: Annotated[dict[str, str], BeforeValidator(_or_empty)] = {}


class _Document(BaseModel):
    content: _Information = Field(alias=_ROOT)
