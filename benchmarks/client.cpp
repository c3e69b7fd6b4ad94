// A client as the vendor's: receive, decode the whole message into storage of its own, copy the IPO position, encode,
// send. FRI 1.x and 2.5 (the bare message). Written from the facts of the protocol; nothing of KUKA's is in it.
// For benchmarks/loop.py: `client FD TOTAL` serves TOTAL messages on an inherited, bound UDP socket whose receive has a
// time-out, and writes the turn-around of each, int64 ns, to its standard output.
#include <sched.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <netinet/in.h>
#include <vector>

namespace {

constexpr int kJoints = 7, kMostSilences = 40;
constexpr uint64_t kMonitoringIdentifier = 0x245142, kCommandIdentifier = 0x34001;

int64_t now_ns() {
    timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

struct Joints {
    double value[kJoints];
    int count;
};

struct Monitoring {
    uint64_t identifier, counter, reflected;
    uint64_t joints, safety, operation, control, drives[kJoints];
    int drive_count;
    Joints position, torque, commanded_position, commanded_torque, external_torque, ipo;
    uint64_t seconds, nanoseconds;
    uint64_t state, quality, send_period, multiplier;
    uint64_t command_mode, overlay;
    double tracking;
};

// One pass over the fields of a message; ok is false where its bytes end early.
struct Reader {
    const uint8_t *at, *end;
    bool ok = true;

    bool next(uint32_t &field, uint32_t &kind) {
        if (!ok || at >= end) return false;
        const uint64_t tag = varint();
        field = static_cast<uint32_t>(tag >> 3);
        kind = static_cast<uint32_t>(tag & 7);
        return ok;
    }
    uint64_t varint() {
        uint64_t value = 0;
        for (int shift = 0; shift < 64 && at < end; shift += 7) {
            const uint8_t byte = *at++;
            value |= uint64_t{byte & 0x7Fu} << shift;
            if (!(byte & 0x80)) return value;
        }
        ok = false;
        return 0;
    }
    double number() {
        double value = 0.0;
        if (end - at < 8) {
            ok = false;
            return value;
        }
        std::memcpy(&value, at, 8);
        at += 8;
        return value;
    }
    Reader inner() {
        const uint64_t size = varint();
        if (!ok || size > static_cast<uint64_t>(end - at)) {
            ok = false;
            return {at, at};
        }
        Reader part{at, at + size};
        at += size;
        return part;
    }
    void skip(uint32_t kind) {
        if (kind == 0) varint();
        else if (kind == 1) number();
        else if (kind == 2) inner();
        else if (kind == 5 && end - at >= 4) at += 4;
        else ok = false;
    }
};

bool read_joints(Reader part, Joints &joints) {
    uint32_t field, kind;
    while (part.next(field, kind)) {
        if (field == 1 && kind == 1 && joints.count < kJoints) joints.value[joints.count++] = part.number();
        else if (field == 1 && kind == 2) {
            Reader packed = part.inner();
            while (packed.ok && packed.at < packed.end && joints.count < kJoints)
                joints.value[joints.count++] = packed.number();
            part.ok = part.ok && packed.ok;
        } else part.skip(kind);
    }
    return part.ok;
}

bool read_numbers(Reader part, uint64_t *const *places, uint32_t count) {
    uint32_t field, kind;
    while (part.next(field, kind)) {
        if (kind == 0 && field <= count && places[field]) *places[field] = part.varint();
        else part.skip(kind);
    }
    return part.ok;
}

bool decode(const uint8_t *data, size_t size, Monitoring &m) {
    std::memset(&m, 0, sizeof m);
    Reader whole{data, data + size};
    uint32_t group, kind;
    while (whole.next(group, kind)) {
        if (kind != 2) {
            whole.skip(kind);
            continue;
        }
        Reader part = whole.inner();
        if (group == 1) {
            uint64_t *const places[] = {nullptr, &m.identifier, &m.counter, &m.reflected};
            whole.ok = whole.ok && read_numbers(part, places, 3);
        } else if (group == 2) {
            uint32_t field, inside;
            while (part.next(field, inside)) {
                if (inside != 0) part.skip(inside);
                else if (field == 5 && m.drive_count < kJoints) m.drives[m.drive_count++] = part.varint();
                else {
                    const uint64_t value = part.varint();
                    if (field == 1) m.joints = value;
                    else if (field == 2) m.safety = value;
                    else if (field == 6) m.operation = value;
                    else if (field == 7) m.control = value;
                }
            }
            whole.ok = whole.ok && part.ok;
        } else if (group == 3) {
            Joints *const arrays[] = {nullptr, &m.position, &m.torque, &m.commanded_position, &m.commanded_torque,
                                      &m.external_torque};
            uint32_t field, inside;
            while (part.next(field, inside)) {
                if (inside == 2 && field <= 5) part.ok = read_joints(part.inner(), *arrays[field]) && part.ok;
                else if (inside == 2 && field == 15) {
                    uint64_t *const places[] = {nullptr, &m.seconds, &m.nanoseconds};
                    part.ok = read_numbers(part.inner(), places, 2) && part.ok;
                } else part.skip(inside);
            }
            whole.ok = whole.ok && part.ok;
        } else if (group == 4) {
            uint64_t *const places[] = {nullptr, &m.state, &m.quality, &m.send_period, &m.multiplier};
            whole.ok = whole.ok && read_numbers(part, places, 4);
        } else if (group == 5) {
            uint32_t field, inside;
            while (part.next(field, inside)) {
                if (inside == 2 && field == 1) part.ok = read_joints(part.inner(), m.ipo) && part.ok;
                else if (inside == 0 && field == 10) m.command_mode = part.varint();
                else if (inside == 0 && field == 11) m.overlay = part.varint();
                else if (inside == 1 && field == 12) m.tracking = part.number();
                else part.skip(inside);
            }
            whole.ok = whole.ok && part.ok;
        }
    }
    return whole.ok && m.identifier == kMonitoringIdentifier;
}

uint8_t *put_varint(uint8_t *at, uint64_t value) {
    while (value >= 0x80) {
        *at++ = static_cast<uint8_t>(value | 0x80);
        value >>= 7;
    }
    *at++ = static_cast<uint8_t>(value);
    return at;
}

size_t encode(uint8_t *out, uint64_t counter, uint64_t reflected, const Joints &position) {
    uint8_t header[32], *at = header;
    for (const auto &[field, value] : {std::pair<int, uint64_t>{1, kCommandIdentifier}, {2, counter}, {3, reflected}}) {
        *at++ = static_cast<uint8_t>(field << 3);
        at = put_varint(at, value);
    }
    uint8_t *end = out;
    *end++ = 0x0A;
    end = put_varint(end, static_cast<uint64_t>(at - header));
    std::memcpy(end, header, static_cast<size_t>(at - header));
    end += at - header;
    if (position.count != kJoints) return static_cast<size_t>(end - out);
    *end++ = 0x12;
    *end++ = 2 + 9 * kJoints;
    *end++ = 0x0A;
    *end++ = 9 * kJoints;
    for (double value : position.value) {
        *end++ = 0x09;
        std::memcpy(end, &value, 8);
        end += 8;
    }
    return static_cast<size_t>(end - out);
}

}  // namespace

int main(int count, char **words) {
    if (count != 3) return 2;
    const int socket = std::atoi(words[1]);
    const size_t total = std::strtoul(words[2], nullptr, 10);
    std::vector<int64_t> turn_around;
    turn_around.reserve(total);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    const sched_param priority{80};  // that of the loop; where it is refused, both do without
    sched_setscheduler(0, SCHED_FIFO, &priority);
    static uint8_t received[1500], answer[1500];
    static Monitoring message;
    uint64_t own_counter = 0;
    for (int silent = 0; turn_around.size() < total && silent < kMostSilences;) {
        sockaddr_in sender{};
        socklen_t length = sizeof sender;
        const ssize_t size =
            recvfrom(socket, received, sizeof received, 0, reinterpret_cast<sockaddr *>(&sender), &length);
        const int64_t begin = now_ns();
        if (size <= 0) {
            silent += !turn_around.empty();
            continue;
        }
        silent = 0;
        if (!decode(received, static_cast<size_t>(size), message) || message.state == 0) continue;
        const Joints &position = message.state >= 3 ? message.ipo : message.commanded_position;
        const size_t bytes = encode(answer, own_counter++, message.counter, position);
        if (sendto(socket, answer, bytes, 0, reinterpret_cast<sockaddr *>(&sender), length) < 0) return 1;
        turn_around.push_back(now_ns() - begin);
    }
    const char *rest = reinterpret_cast<const char *>(turn_around.data());
    for (size_t left = turn_around.size() * sizeof(int64_t); left > 0;) {
        const ssize_t written = write(STDOUT_FILENO, rest, left);
        if (written <= 0) return 1;
        rest += written;
        left -= static_cast<size_t>(written);
    }
    return 0;
}
