"""Colours, the same as in the report."""

from rpod_schemas.types import IntegrityState, Mode, Source

ESTIMATE = (255, 77, 46)
TRUTH = (225, 230, 236)
QUIET = (139, 148, 158)
ACCENT = (47, 125, 246)
ELLIPSOID = (255, 209, 102)
BACKGROUND = (13, 17, 23)

MODES = {
    Mode.ACQUIRING: (184, 191, 199),
    Mode.VERIFYING: (156, 195, 251),
    Mode.TRACKING: (46, 160, 67),
    Mode.LOST: (217, 83, 79),
    Mode.COASTING: (232, 176, 74),
}
INTEGRITY = {
    IntegrityState.UNAVAILABLE: QUIET,
    IntegrityState.NOMINAL: (46, 160, 67),
    IntegrityState.CAUTION: (232, 176, 74),
    IntegrityState.ALERT: (217, 83, 79),
}
SOURCES = {
    Source.NONE: QUIET,
    Source.LIDAR: (104, 109, 224),
    Source.PMD_DEPTH: ACCENT,
    Source.PMD_AMPLITUDE: (191, 120, 214),
    Source.PMD_JOINT: (33, 150, 166),
    Source.OTHER: (184, 134, 84),
}
