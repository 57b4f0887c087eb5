"""ConnectFour: two players drop discs into a grid, and four in a row win."""
