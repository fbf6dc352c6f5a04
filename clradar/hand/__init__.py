"""A parametric hand as a radar target: poses, shapes, forward kinematics, and a closed surface.

The surface is an implicit one, round cones along the bones united by smooth minima, triangulated by
marching cubes; see ``docs/poses.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
