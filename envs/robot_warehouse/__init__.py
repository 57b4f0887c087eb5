"""RobotWarehouse: robots carry requested shelves to a goal and back."""
