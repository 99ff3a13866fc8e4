#!/bin/busybox sh
export PATH=/bin
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
for module in /modules/*.ko; do insmod $module; done
nine=trans=virtio,version=9p2000.L,msize=1048576
mount -t 9p -o $nine,ro,cache=loose root /lower || poweroff -f
mount -t tmpfs -o size=60% tmpfs /layer
mkdir /layer/above /layer/work
mount -t overlay -o lowerdir=/lower,upperdir=/layer/above,workdir=/layer/work overlay /new
for word in $(cat /proc/cmdline); do case $word in shared=*) shared=${word#shared=};; esac; done
mkdir -p /new$shared
mount -t 9p -o $nine,rw,cache=none shared /new$shared || poweroff -f
umount /proc /sys
mount --move /dev /new/dev
exec switch_root /new /bin/sh $shared/start
