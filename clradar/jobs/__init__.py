"""Long work: folders that resume, and where their items are worked on."""

from clradar.jobs.job import KEY, FolderStore, Job, remove
from clradar.jobs.where import Where, map_devices, open_devices

__all__ = ["KEY", "FolderStore", "Job", "Where", "map_devices", "open_devices", "remove"]
