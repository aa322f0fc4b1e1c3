"""Codecs: each module converts the messages of one protocol to bytes and back. They use no clock and no socket."""
