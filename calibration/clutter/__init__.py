"""Background subtraction and range gating."""
