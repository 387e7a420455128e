"""Identification of actuators drawn at random, whose truth is known, from records of many shapes."""
