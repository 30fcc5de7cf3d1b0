"""Capture devices behind one interface: no threads, no clock of their own, nothing of vision."""
