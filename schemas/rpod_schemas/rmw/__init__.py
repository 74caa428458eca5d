"""The form in which ROS 2's rmw_zenoh speaks: CDR, quality of service, types of services, attachments."""
