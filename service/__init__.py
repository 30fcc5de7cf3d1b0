"""Bowlsight's service: from frames to tube centres, camera pose and what an operator sees."""

__version__ = "0.1.0"
