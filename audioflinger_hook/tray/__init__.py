"""The tray icon: switches the running daemon, and shows its state.

| module | contents |
| --- | --- |
| `menu` | the entries of the menu, and the request of each |
| `item` | icon and menu on D-Bus: StatusNotifierItem and com.canonical.dbusmenu |
"""
