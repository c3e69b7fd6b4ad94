"""What changes between the periods of a recording, and pushes that come with every one."""
