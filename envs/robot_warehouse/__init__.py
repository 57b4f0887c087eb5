"""RobotWarehouse: robots carry shelves that are asked for to a goal, and back."""
