"""The ray tracer: surface samples, visibility, outgoing rays, receptions."""
