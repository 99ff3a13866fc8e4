# Arguments: a folder for the layer, the shared folder, then folders to read from.
trap 'exit 97' EXIT
mount -t tmpfs layer "$1"
cd "$1"
mkdir upper work new
mount -t overlay -o lowerdir=/,upperdir=upper,workdir=work overlay new
cd new
mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,bind,ro proc/sys
mount -t sysfs -o ro sys sys
mount -t cgroup2 cgroup sys/fs/cgroup
mount -t tmpfs -o mode=755 dev dev
for each in null zero full random urandom tty; do
    touch dev/$each
    mount --bind /dev/$each dev/$each
done
mkdir dev/pts dev/shm
mount -t devpts -o newinstance,ptmxmode=0666,mode=620 devpts dev/pts
ln -s pts/ptmx dev/ptmx
ln -s /proc/self/fd dev/fd
mount -t tmpfs shm dev/shm
mount -t tmpfs -o mode=755 run run
mount -t tmpfs -o mode=1777 tmp tmp
shared=$2
mkdir -p ".$shared"
mount --bind "$shared" ".$shared"
shift 2
for each; do # these may lie on other file systems, and where only root may look
    mkdir -p ".$each"
    mount --bind -o ro "$each" ".$each"
    while [ "$each" != / ]; do
        each=$(dirname "$each")
        chmod a+x ".$each"
    done
done
rm -rf etc/systemd/system/*.wants etc/systemd/system/*.requires
: >etc/fstab
cp "$shared"/booted.service etc/systemd/system/
mkdir old
trap - EXIT
exec "$PYTHON" -c "$PIVOT"
