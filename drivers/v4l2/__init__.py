"""Capture devices through the Linux kernel's own interface, Video4Linux2."""
