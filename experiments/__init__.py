"""Training scripts, and one script for each table and figure; installed as ``pearl_marl.experiments``."""
