"""What a record says before there is any model: its dead time, feedback from output to input, its noise."""
