"""RTPS, the wire of DDS, as far as robots need it: discovery, best effort, reliable delivery, fragments.

    participant = Participant(address="192.168.123.99")      # sockets are open
    writer = participant.writer("rt/lowcmd", "unitree_hg::msg::dds_::LowCmd_")
    reader = participant.reader("rt/lowstate", "unitree_hg::msg::dds_::LowState_", on_sample)
    nursery.start_soon(participant.run)                       # or poll() now and then
    await participant.wait_matched(writer, reader)
    writer.write(payload)                                     # an ordinary function

Protocol 2.2, IPv4. No type information is sent: a peer of another generation stumbles over it. Not here: security,
keys, content filters, deadlines, liveliness beyond the participant's lease, IPv6.
"""

from .engine import Counters
from .participant import Participant, open_participant
from .reader import Reader
from .writer import Writer

__all__ = ["Counters", "Participant", "Reader", "Writer", "open_participant"]
