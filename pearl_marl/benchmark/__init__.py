"""Speed, beside that of other packages and measured in turns: of steps, many agents, and whole trainings.

``training`` needs the ``train`` extra, and the trainers of other packages need ``peers``.
"""
