"""The looks of a robot: smooth outlines for pictures, from a table of text. Physics never sees them.

``outlines``   make the surface of one part: a rod, a can, a box, a ball
``rows``       read the table
``materials``  colours and finishes by name
``dress``      put the outlines onto a copy of a model that is drawn
"""
