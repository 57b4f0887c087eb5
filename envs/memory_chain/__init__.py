"""MemoryChain: remember what was seen in the first step until the last."""
