#!/bin/sh
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
mount -t proc proc /proc; mount -t sysfs sys /sys
mkdir -p /dev/pts /dev/shm; mount -t devpts devpts /dev/pts; mount -t tmpfs shm /dev/shm
mount -t tmpfs run /run
mkdir -p -m 700 /run/user; export XDG_RUNTIME_DIR=/run/user
ip link set lo up 2>/dev/null || /bin/busybox ifconfig lo 127.0.0.1 up
modprobe -d {kernel} -a {bus} snd-usb-audio
cd {root}
{command} </dev/null >{shared}/output 2>&1
echo $? >{shared}/code
dmesg >{shared}/kernel.log
sync
/bin/busybox poweroff -f
