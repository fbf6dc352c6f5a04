"""Files: failures, limits, atomic writing, work folders, JSON, TOML, tables, pickles, hashing."""
