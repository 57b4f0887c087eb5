"""What goes into a device and what comes out of it, for all slots at once."""
