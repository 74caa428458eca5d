"""Frames that show more than the target: walls, a stand, the arm that holds the target, things before it.

Parts of a frame that belong to other things are taken out of it before the methods see it, so that they
neither attract the pose nor contradict it. A ray that passes through the place where the target should be
remains a contradiction.
"""
