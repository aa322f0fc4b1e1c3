"""A DDS participant in pure Python: RTPS, the wire protocol of DDS, as far as robots need it.

It supports discovery, best-effort and reliable delivery, and fragments.

    participant = Participant(address="192.168.123.99")      # sockets are open
    writer = participant.writer("rt/lowcmd", "unitree_hg::msg::dds_::LowCmd_")
    reader = participant.reader("rt/lowstate", "unitree_hg::msg::dds_::LowState_", on_sample)
    nursery.start_soon(participant.run)                       # or call poll() regularly
    await participant.wait_matched(writer, reader)
    writer.write(payload)                                     # an ordinary function

A remote endpoint counts as matched when its participant has acknowledged our endpoint. A reliable remote endpoint
must also have sent a message to our endpoint. From then on, samples are received. The age of a sample counts from
the time at which the kernel received its datagram. Every table is bounded (peers, remote endpoints, early samples,
fragments), and drops are counted.

A datagram with a peer's name is accepted only from that peer's address, and its sequence numbers must follow the
last ones. So a single datagram from another address cannot end a connection. A sender that also forges the address
is accepted, because the protocol cannot detect this. So connect robots with legs to a separate network.

Protocol 2.2, IPv4. No type information is sent, because participants of other DDS versions fail on it. Not
supported: security, keys, content filters, deadlines, liveliness beyond the participant's lease (the announced
time within which it must send again), IPv6.
"""

from .engine import Counters
from .participant import Participant, open_participant
from .reader import Reader
from .sockets import own_address
from .wire_types import CDR, MULTICAST_GROUP, PREFIX_SIZE
from .writer import Writer

__all__ = [
    "CDR",
    "MULTICAST_GROUP",
    "PREFIX_SIZE",
    "Counters",
    "Participant",
    "Reader",
    "Writer",
    "open_participant",
    "own_address",
]
