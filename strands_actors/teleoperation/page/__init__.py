"""The web page by which an operator moves a robot, by touch or with a gamepad, over one WebSocket."""
