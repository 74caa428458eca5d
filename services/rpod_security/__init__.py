"""Identity and rights on the bus: certificates, access rules made from the configuration, audit records.

Nothing is imported here: only what reads or makes certificates needs the package ``cryptography``.
"""
