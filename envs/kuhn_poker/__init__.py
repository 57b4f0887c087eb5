"""KuhnPoker: two players, three cards, and one bet."""
