"""What one trial does: scenes, scans, methods, and the rows that come of them.

All that decides a row stands here or in the packages below; tables and figures stand one folder up.
"""
