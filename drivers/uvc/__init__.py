"""USB video class devices without a kernel driver, read from user space."""
