"""Message types of the log: ROS 2 Humble's, foxglove_msgs/Grid, and our own.

The definitions that Humble does not have are in ``msg/<package>.<Type>.msg``. Each channel of
a log carries the full text of its type, so that a log can be read without this package.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

SCHEMA_ENCODING: Final = "ros2msg"
MESSAGE_ENCODING: Final = "cdr"

_SEPARATOR: Final = "=" * 80 + "\n"


@cache
def own_definitions() -> dict[str, str]:
    """The text of each definition in ``msg/`` by type, like ``mapreplay_msgs/msg/Decision``."""
    texts = {}
    for file in sorted(files(__package__).joinpath("msg").iterdir(), key=lambda file: file.name):
        package, name, _ = file.name.split(".")
        texts[f"{package}/msg/{name}"] = file.read_text(encoding="utf-8")
    return texts


@cache
def typestore() -> Typestore:
    """All message types that a log may contain."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in own_definitions().items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def schema_text(type_name: str) -> str:
    """The definition of a type, followed by those of all types that it contains.

    Types of ``msg/`` keep their comments, which say units and ranges.
    """
    generated, _ = typestore().generate_msgdef(type_name, ros_version=2)
    first, *others = generated.split(_SEPARATOR)
    own = own_definitions()
    parts = [own.get(type_name, first)]
    for part in others:
        title, _, body = part.partition("\n")
        package, _, name = title.removeprefix("MSG: ").partition("/")
        parts.append(f"{title}\n{own.get(f'{package}/msg/{name}', body)}")
    return _SEPARATOR.join(parts)
