"""LeducPoker: two players, six cards of three ranks, and two rounds of bets."""
