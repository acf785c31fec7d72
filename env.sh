# Environment of this workspace, for bash and zsh:  source env.sh
# With .venv/ (see Makefile): its interpreter, wheels and install/. Without: a full ROS 2 Jazzy and install/.

# zsh has no BASH_SOURCE, but $0 is the sourced file there.
_neuse_root=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")" && pwd)
_neuse_shell=bash
[ -n "${ZSH_VERSION:-}" ] && _neuse_shell=zsh

_neuse_source() {
    [ ! -f "$1" ] || . "$1"
}

if [ -d "$_neuse_root/.venv" ]; then
    export VIRTUAL_ENV="$_neuse_root/.venv"
    case ":$PATH:" in
        *":$VIRTUAL_ENV/bin:"*) ;;
        *) export PATH="$VIRTUAL_ENV/bin:$PATH" ;;
    esac
    _neuse_source "$_neuse_root/install/setup.$_neuse_shell"
    case ":${AMENT_PREFIX_PATH:-}:" in
        *":$VIRTUAL_ENV:"*) ;;
        *) export AMENT_PREFIX_PATH="${AMENT_PREFIX_PATH:+$AMENT_PREFIX_PATH:}$VIRTUAL_ENV" ;;
    esac
    # Whole images fit into shared memory.
    export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$_neuse_root/tools/fastdds.xml}"
    # The library is read from the tree, so that an edit needs no build.
    case ":${PYTHONPATH:-}:" in
        ":$_neuse_root:"*) ;;
        *) export PYTHONPATH="$_neuse_root${PYTHONPATH:+:$PYTHONPATH}" ;;
    esac
else
    [ -n "${ROS_DISTRO:-}" ] || _neuse_source "/opt/ros/jazzy/setup.$_neuse_shell"
    _neuse_source "$_neuse_root/install/setup.$_neuse_shell"
fi

unset -f _neuse_source
unset _neuse_root _neuse_shell
