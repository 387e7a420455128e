"""Ways to and from python-control: systems, time responses, describing functions."""
