"""The page of an operator: touch and gamepads, by the browser's own means, over one WebSocket."""
