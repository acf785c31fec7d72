"""Bags whose topics have other names than the graph listens to, or compressed images."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from neuse.errors import BagError, NeuseError, ParamError
from neuse_bags import compressed
from neuse_bags.mcap_file import BagReader, BagTopic, RawMessage
from neuse_bags.roles import ROLES
from neuse_bags.topics import COLOR

KNOWN = {role.topic.name: role.topic.type_name for role in ROLES}


class RenamedBag(BagReader):
    """A bag seen through a table of names. A topic whose name another one is given is not seen.

    Compressed images on a topic of the graph that takes images are seen as images. Colour pictures that
    cannot be unpacked are passed over, and their faults join `skipped`.

    Raises:
        BagError: like BagReader; or the bag lacks a topic of the table.
    """

    def __init__(self, path: Path, names: Mapping[str, str]) -> None:
        """names: the graph's name by the bag's own."""
        super().__init__(path)
        lacking = sorted(names.keys() - self.topics.keys())
        if lacking:
            self.close()
            has = ", ".join(sorted(self.topics)) or "nothing"
            raise BagError(f"{path} lacks {', '.join(lacking)}, which is to be renamed; it has {has}")
        kept = {name: name for name in self.topics if name not in names and name not in names.values()}
        self._new_names = kept | dict(names)
        renamed = (replace(self.topics[old], name=new) for old, new in self._new_names.items())
        self._packed = set[str]()
        self.skipped: list[NeuseError] = []
        self.topics = {topic.name: self._plain(topic) for topic in renamed}

    def _plain(self, topic: BagTopic) -> BagTopic:
        """The topic as it is seen; those that are to be unpacked are remembered."""
        if topic.type_name != compressed.PACKED_TYPE or KNOWN.get(topic.name) != compressed.TYPE:
            return topic
        self._packed.add(topic.name)
        return replace(topic, type_name=compressed.TYPE)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Messages in the order of their log stamps, of all topics or of those given, under the new names.

        Raises:
            BagError: as BagReader's.    InputError: a compressed depth image or mask cannot be unpacked.
        """
        wanted = [old for old, new in self._new_names.items() if topics is None or new in topics]
        for message in super().messages(wanted):
            renamed = replace(message, topic=self._new_names[message.topic])
            seen = self._unpacked(renamed) if renamed.topic in self._packed else renamed
            if seen is not None:
                yield seen

    def _unpacked(self, message: RawMessage) -> RawMessage | None:
        try:
            return compressed.unpacked(message)
        except NeuseError as error:
            if message.topic != COLOR.name:
                raise
            self.skipped.append(error)
            return None


def read_names(entries: Sequence[str]) -> dict[str, str]:
    """The table of `FROM:=TO` words and of YAML files with lines `FROM: TO`.

    Raises:
        ParamError: a word is neither, or TO is no topic of the graph, or is given twice.
    """
    pairs = [pair for entry in entries for pair in _pairs(entry)]
    names = {_absolute(old): _absolute(new) for old, new in pairs}
    for old, new in names.items():
        if new not in KNOWN:
            raise ParamError(f"--remap {old}:={new}: the graph has no {new}; write one of {', '.join(KNOWN)}")
    twice = [new for new in names.values() if list(names.values()).count(new) > 1]
    if twice:
        raise ParamError(f"--remap gives {twice[0]} to more than one topic; write it once")
    return names


def _pairs(entry: str) -> list[tuple[str, str]]:
    old, assigned, new = entry.partition(":=")
    if assigned:
        return [(old, new)]
    try:
        table = yaml.safe_load(Path(entry).read_text())
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise ParamError(f"--remap {entry} is neither FROM:=TO nor a YAML file: {reason}") from error
    if not isinstance(table, dict) or not all(isinstance(word, str) for word in [*table, *table.values()]):
        raise ParamError(f"{entry} is no table of names; write lines such as `/camera/depth: /depth/image`")
    return list(table.items())


def _absolute(name: str) -> str:
    return f"/{name.lstrip('/')}"
