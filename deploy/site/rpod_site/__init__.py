"""The documentation site: pages from the repository's documents and code, built as static files.

The pages are staged under ``build/site/pages`` in the repository's own folders, so that a link that works in
the repository works in the site. No fact is written by hand a second time.
"""
