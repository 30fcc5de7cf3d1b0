"""Recorded sessions: a folder that can be replayed, searched and checked."""
