"""The operator's page: what it shows, who may use it, and how it is served."""
