"""The common part of all buses of position servos. The ``protocol`` module of a wire is the ``Codec`` that
this code uses."""
