"""Long work: folders that resume, and where their items are worked on."""

from clradar.jobs.job import FolderStore, Job
from clradar.jobs.where import Where, map_devices, open_devices

__all__ = ["FolderStore", "Job", "Where", "map_devices", "open_devices"]
