"""Ray tracing: surface samples, visibility, outgoing directions, receptions."""
