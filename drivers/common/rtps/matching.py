"""Match our writers and readers with those of other participants. Pure.

Remote endpoints that are not compatible are kept too, because a compatible endpoint of ours may be created later.
The table is bounded. If it is full, an endpoint of a topic that we do not use is removed first.
"""

from __future__ import annotations

from collections.abc import Callable

from .discovery import EndpointData, mismatch
from .reader import Reader
from .wire_types import PREFIX_SIZE, Address
from .writer import Writer

MAX_ENDPOINTS = 1024
"""Remote writers kept; also the number of remote readers."""

MAX_MATCHED = 64
"""Matches of one endpoint. Each costs a datagram for every sample, or for every heartbeat that is
due."""

Locate = Callable[[EndpointData], Address | None]
"""Returns the address of a remote endpoint, or None if its participant is unknown."""


class Matching:
    def __init__(self, locate: Locate, changed: Callable[[], object]) -> None:
        """Create an empty table. ``changed`` is called after each match, and after each end of a match."""
        self.writers: dict[bytes, Writer] = {}  # our writers, by entity id
        self.readers: dict[bytes, Reader] = {}
        self.hearing: dict[bytes, tuple[Reader, ...]] = {}
        """Our readers by the GUID of the remote writer that they receive from."""
        self._locate = locate
        self._changed = changed
        self._remote_writers: dict[bytes, EndpointData] = {}
        self._remote_readers: dict[bytes, EndpointData] = {}

    # -- ours

    def add_writer(self, writer: Writer) -> None:
        self.writers[writer.data.guid[PREFIX_SIZE:]] = writer
        for remote in self._remote_readers.values():
            self._try_reader(writer, remote)

    def add_reader(self, reader: Reader) -> None:
        self.readers[reader.entity] = reader
        for remote in self._remote_writers.values():
            self._try_writer(reader, remote)

    def join_reader(self, writer: Writer, remote: EndpointData, address: Address) -> None:
        writer.match(remote, address)
        self._changed()

    def join_writer(self, reader: Reader, remote: EndpointData, address: Address) -> None:
        readers = self.hearing.get(remote.guid, ())
        if reader not in readers:
            self.hearing[remote.guid] = (*readers, reader)
        reader.match(remote, address)
        self._changed()

    # -- theirs

    def learn_writer(self, remote: EndpointData) -> bool:
        """Add a remote writer, or update it if it is known.

        Returns:
            False if the table has no room for the writer.
        """
        if not self._remember(self._remote_writers, remote, self.forget_writer):
            return False
        for reader in self.readers.values():
            self._try_writer(reader, remote)
        return True

    def learn_reader(self, remote: EndpointData) -> bool:
        if not self._remember(self._remote_readers, remote, self.forget_reader):
            return False
        for writer in self.writers.values():
            self._try_reader(writer, remote)
        return True

    def relocate(self, prefix: bytes) -> None:
        """Use the new address of a participant for all its endpoints."""
        for guid, remote in self._remote_writers.items():
            if guid.startswith(prefix):
                self.learn_writer(remote)
        for guid, remote in self._remote_readers.items():
            if guid.startswith(prefix):
                self.learn_reader(remote)

    def forget_writer(self, guid: bytes) -> None:
        self._remote_writers.pop(guid, None)
        readers = self.hearing.pop(guid, ())
        for reader in readers:
            reader.unmatch(guid)
        if readers:
            self._changed()

    def forget_reader(self, guid: bytes) -> None:
        self._remote_readers.pop(guid, None)
        if sum(writer.unmatch(guid) for writer in self.writers.values()):
            self._changed()

    def forget_peer(self, prefix: bytes) -> None:
        for guid in [guid for guid in {**self._remote_writers, **self.hearing} if guid.startswith(prefix)]:
            self.forget_writer(guid)
        for guid in [guid for guid in self._remote_readers if guid.startswith(prefix)]:
            self.forget_reader(guid)
        for writer in self.writers.values():
            writer.unmatch_participant(prefix)

    def _remember(
        self, table: dict[bytes, EndpointData], remote: EndpointData, forget: Callable[[bytes], None]
    ) -> bool:
        previous = table.get(remote.guid)
        if previous is not None and previous != remote:
            forget(remote.guid)
        elif previous is None and len(table) >= MAX_ENDPOINTS:
            ours = {writer.data.topic for writer in self.writers.values()}
            ours |= {reader.data.topic for reader in self.readers.values()}
            spare = next((guid for guid, endpoint in table.items() if endpoint.topic not in ours), None)
            if remote.topic not in ours or spare is None:
                return False
            forget(spare)
        table[remote.guid] = remote
        return True

    def _try_reader(self, writer: Writer, remote: EndpointData) -> None:
        if writer.data.topic != remote.topic:
            return
        writer.mismatch = mismatch(writer.data, remote)
        address = self._locate(remote)
        if not writer.mismatch and address and writer.has_room(remote.guid, MAX_MATCHED):
            self.join_reader(writer, remote, address)

    def _try_writer(self, reader: Reader, remote: EndpointData) -> None:
        if reader.data.topic != remote.topic:
            return
        reader.mismatch = mismatch(remote, reader.data)
        address = self._locate(remote)
        if not reader.mismatch and address and reader.has_room(remote.guid, MAX_MATCHED):
            self.join_writer(reader, remote, address)
