"""Injection of the faults of the catalogue into a sensor's messages: one class a fault.

An injection takes each message before it is published and returns what is published in its place. It knows
no bus, no clock and no emulator. So the emulator, a test or a campaign can put a fault into the messages of
any sensor.
"""

from rpod_sim_sensor.faults.injection import Injection, Outgoing, injection, parts_of, stamped

__all__ = ["Injection", "Outgoing", "injection", "parts_of", "stamped"]
