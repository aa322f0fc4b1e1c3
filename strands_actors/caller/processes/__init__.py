"""The processes of a robot: how they start, where they are found, what they leave behind."""
