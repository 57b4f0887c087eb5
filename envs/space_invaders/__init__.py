"""SpaceInvaders: a cannon under a formation of aliens, as MinAtar has them."""
