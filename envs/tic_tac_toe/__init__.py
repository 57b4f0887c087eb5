"""TicTacToe: two players mark cells in turn, and three in a row win."""
