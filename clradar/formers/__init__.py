"""Ways to form an image: host side of the kernels ``backproject_*.cl``."""
