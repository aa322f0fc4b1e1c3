"""The processes of a robot: start them, find them again, and remove the files that they leave behind."""
