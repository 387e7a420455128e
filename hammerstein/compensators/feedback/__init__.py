"""Laws that read the sensor."""
