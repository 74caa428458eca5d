"""The services beside motion, sensors and estimator, how a host keeps them up, links, rights."""
