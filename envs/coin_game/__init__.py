"""CoinGame: two players collect coins, and whoever takes the other's colour costs the other two points."""
