"""Files: failures, atomic writing, work folders, JSON, TOML, hashing."""
