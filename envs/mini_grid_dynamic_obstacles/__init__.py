"""MiniGridDynamicObstacles: walk to a goal among balls that move, as MiniGrid has it."""
