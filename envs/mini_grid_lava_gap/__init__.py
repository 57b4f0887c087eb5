"""MiniGridLavaGap: pass through a gap in a strip of lava, as MiniGrid has it."""
