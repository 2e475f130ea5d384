"""Every error that mapreplay raises on purpose.

    MapreplayError            exit 1   something could not be done
    ├── UsageError            exit 2   the request names something unknown or invalid
    │   ├── ConfigError                a key of the configuration has an illegal value
    │   ├── PluginError                a planner, predictor, source or metric is unknown or broken
    │   └── ExistsError                the file to be written exists
    ├── WriteError                     a file cannot be written; an existing one is unchanged
    ├── FloorPlanError                 a floor plan cannot be read, or makes no sense
    ├── WeightsError                   a predictor's weights cannot be read
    └── LogError                       a log cannot be read or written

The text is one line: what is wrong, in which file, and what to do.
"""

from __future__ import annotations

from typing import ClassVar


class MapreplayError(Exception):
    """Base of all errors of this package; the command line prints it as one line."""

    exit_code: ClassVar[int] = 1


class UsageError(MapreplayError):
    """The request itself is invalid; nothing was done."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration key has a value outside its allowed range."""


class PluginError(UsageError):
    """A plug-in is unknown, or failed to load."""


class ExistsError(UsageError):
    """The file to be written exists, or its name is that of a link, folder or device."""


class WriteError(MapreplayError):
    """A file cannot be written; an existing one is unchanged."""


class FloorPlanError(MapreplayError):
    """A floor plan cannot be read, or is refused."""


class WeightsError(MapreplayError):
    """Predictor weights cannot be read."""


class LogError(MapreplayError):
    """An episode log cannot be read or written."""
