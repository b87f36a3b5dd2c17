"""From external torque to contact, and from contact to demonstrations and corrections."""
