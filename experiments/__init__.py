"""Scripts: one for each table and figure, and the report; installed as ``pearl_marl.experiments``."""
