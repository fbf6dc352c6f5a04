"""Exception classes: one base, each subclass also a builtin."""


class ClradarError(Exception):
    """Base of every error that clradar, measurement_io and calibration raise on purpose."""


class ModelError(ClradarError, ValueError):
    """A field or an argument has an invalid value."""


class MeshError(ClradarError, ValueError):
    """A mesh file or a mesh cannot be used as a scene."""


class RigError(ClradarError, ValueError):
    """A file of a rigged hand is damaged, or holds no hand that a pose can move."""


class DeviceError(ClradarError, RuntimeError):
    """OpenCL: no such device, a kernel that does not build, no memory, a failed launch."""


class MeasurementError(ClradarError, ValueError):
    """A recorded or native file is missing, damaged, hostile, or of another format than stated."""


class CompareError(ClradarError, ValueError):
    """Two images cannot be compared or aligned."""


class CalibrationError(ClradarError, ValueError):
    """A capture does not show the known target, or a calibration is of another instrument."""


class OutputError(ClradarError, OSError):
    """An output cannot be written: it exists already, or its folder does not."""


class ClusterError(ClradarError, RuntimeError):
    """Processes on this or other machines cannot be started, reached, or do not fit together."""
