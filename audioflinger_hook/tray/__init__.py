"""The tray icon: `menu` has the entries of its menu, and `item` shows both on D-Bus."""
