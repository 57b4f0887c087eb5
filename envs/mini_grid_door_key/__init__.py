"""MiniGridDoorKey: fetch a key to open the door to the goal, as MiniGrid has it."""
