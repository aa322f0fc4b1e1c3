"""The links of a robot as rows of text, and where they are. Pure Python."""
