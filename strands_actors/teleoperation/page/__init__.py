"""The web page of an operator, for touch and gamepads (by the browser's API), over one WebSocket."""
