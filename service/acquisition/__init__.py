"""From a grabber to the measuring worker: threads, the newest-wins slot, the ledger."""
