"""Where results go: each sink behind its own bounded queue and thread."""
