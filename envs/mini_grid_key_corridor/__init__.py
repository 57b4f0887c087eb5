"""MiniGridKeyCorridor: find the key that opens the room with the ball."""
