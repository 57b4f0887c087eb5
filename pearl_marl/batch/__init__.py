"""What goes into a device and what comes out of it, for all slots at once.

May import what describes an environment (``spec``, ``golden``), and nothing above that.
"""
