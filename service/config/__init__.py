"""What users write: steam generators, cameras, the station. Every check of a setting stands here."""
