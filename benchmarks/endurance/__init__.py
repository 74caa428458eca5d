"""A facility that ``rpod up`` keeps, beside a bare echo over the same router: its processes killed, and watched for hours."""
