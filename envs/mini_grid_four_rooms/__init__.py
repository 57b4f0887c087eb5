"""MiniGridFourRooms: find a goal in four rooms, as MiniGrid has it."""
