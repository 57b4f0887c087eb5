"""The trainers that are compared, a module each with ``train(task, settings, watch)``.

``python -m`` this package runs one training in a process of its own.
"""
