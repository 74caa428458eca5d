"""A facility that ``rpod up`` keeps, beside a bare echo: its services are killed, and watched for hours."""
