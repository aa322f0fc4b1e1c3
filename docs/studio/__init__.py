"""Make the pictures of the documentation, without a display: ``python -m docs pictures``.

It needs the extra ``test``.

``command``    the command line
``robots``     the picture of a robot's twin, in a pose of ``poses.toml``
``camera``     a camera that a robot fills
``light``      soft light and a plain floor
``watching``   runs the demo on a twin and records it; ``demo`` draws the record as an animation
``lowering``   the speed of an arm that falls, and of one that is lowered
``live``       the live view, in Rerun's own viewer; it needs the extra ``rerun``
``terminal``   pictures of ``top`` and of a drill
"""
