"""Present results: Rerun log, report page and plots."""
