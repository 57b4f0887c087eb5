"""MiniGridEmpty: walk to a goal through an empty room, as MiniGrid has it."""
