"""The format of ROS 2's rmw_zenoh: CDR, quality of service, types of services, attachments."""
