"""Monte-Carlo campaigns: many trials of the estimator's methods, beside the figures of the papers.

Each campaign has a folder with its options, its trial and its report; ``catalogue.py`` finds them by name.
The engine knows no campaign, sensor or method.
"""
