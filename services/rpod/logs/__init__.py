"""The verbs that read logs: ``report``, ``replay``, ``recover``, ``verify-log``."""
