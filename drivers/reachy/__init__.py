"""Drive a Pollen Robotics Reachy Mini through its daemon."""
