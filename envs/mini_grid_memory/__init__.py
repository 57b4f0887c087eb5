"""MiniGridMemory: remember a thing, and go to its like at the end of a hall, as MiniGrid has it."""
