"""Commands on demonstrations: recording, teleoperation, conversion, augmentation."""
