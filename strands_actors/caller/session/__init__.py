"""A program's session with one robot. It holds the right to command (lease), and sends commands and motions."""
