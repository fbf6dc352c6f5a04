"""Scripts to run, copy and edit."""
