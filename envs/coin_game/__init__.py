"""CoinGame: two players collect coins, and taking one of the other's colour costs the other two points."""
