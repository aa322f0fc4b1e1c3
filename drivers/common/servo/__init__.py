"""What the buses of position servos share. A wire's ``protocol`` module is the ``Codec`` all of it
speaks."""
