"""Back-projection by three methods: exact, range profiles, fast."""
