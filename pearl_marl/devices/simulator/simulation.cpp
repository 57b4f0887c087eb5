// The host's side of a simulated board: what the wrapper that PyVerilator generates is extended by.
//
// A whole step is one call: the bytes of a write go in, the clock runs until the interrupt, the bytes
// of a read come out. They take one of two ways, which give the same bytes:
//
// - over the AXI4 port, beat by beat, as an XDMA core would send them;
// - for regions that have a backdoor, straight into or out of the memory behind them; states only out.
//   Everything else, doorbell and status among it, goes over the port all the same. As a read of the first
//   result does over the port, one from the back clears the status's mark of results not read.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#define PEARL_ERROR(model) model->rootp->pearl_top__DOT__u_backbone__DOT__u_registers__DOT__error_q

namespace {

constexpr uint64_t kWordBytes = sizeof(PEARL_MODEL::s_axi_wdata);
constexpr uint64_t kBurstBytes = 4096;  // AXI: no burst crosses a multiple of this
constexpr uint64_t kBurstBeats = 256;
constexpr uint64_t kHalfPeriod = 5;  // in the nanoseconds of a waveform
constexpr uint64_t kFirstTime = 10;  // PyVerilator's own first entry stands there
constexpr unsigned kIncrementing = 1;
constexpr int kBackdoors = 5;
constexpr int kObservations = 2;  // among them
constexpr unsigned kTornRead = 4;  // of the status's error word
constexpr int kRowMemories = 2;
// After a reset the pipeline drains, which takes longer than any core's latency.
constexpr uint64_t kDrainCycles = 1000;

// What a call returns, as simulation.py beside this reads it.
enum Answer : int { kOkay = 0, kNoHandshake = 1, kNoInterrupt = 2, kStopped = 3, kRefused = 16 };

struct Window {
    uint64_t begin, end;
    uint8_t* memory;
};

// One word of every row, as the model stores it: padded to a type of C++.
struct Column {
    const uint8_t* memory;
    uint64_t bytes;
};

// A pearl_row_memory.
struct RowMemory {
    uint64_t begin, end, rows;
    std::vector<Column> columns;

    void read(uint8_t* data) const {
        const uint64_t row_bytes = (end - begin) / rows;
        std::memset(data, 0, end - begin);
        for (uint64_t row = 0; row < rows; row++, data += row_bytes) {
            uint8_t* word = data;
            for (const Column& column : columns) {
                const uint64_t bytes = std::min(column.bytes, kWordBytes);
                std::memcpy(word, column.memory + row * column.bytes, bytes);
                word += kWordBytes;
            }
        }
    }
};

struct Host {
    PEARL_MODEL* top;
    VerilatedVcdC* vcd;
    uint64_t patience;  // clock cycles until a wait is given up
    uint64_t clock;     // clock cycles since the simulation began
    uint64_t time;
    int answer;
    Window windows[kBackdoors];
    RowMemory row_memories[kRowMemories];

    void dump() {
#if VM_TRACE
        time += kHalfPeriod;
        if (vcd) vcd->dump(time);
#endif
    }

    // The simulator finds a model's context by thread, and calls come from any.
    void enter() { Verilated::threadContextp(top->contextp()); }

    // Before the edge: inputs are settled, and so are the outputs that the edge will see.
    void settle() {
        top->clk_i = 0;
        top->eval();
        dump();
    }

    void edge() {
        clock++;
        top->clk_i = 1;
        top->eval();
        dump();
        if (top->contextp()->gotFinish()) fail(kStopped);
    }

    void cycles(uint64_t count) {
        while (count--) {
            settle();
            edge();
        }
    }

    void wait_for_end(uint64_t most) {
        for (uint64_t i = 0; i < most && answer == kOkay; i++) {
            settle();
            const bool ended = top->irq_o;
            edge();
            if (ended) return;
        }
        fail(kNoInterrupt);
    }

    // The first thing that goes wrong is what a call answers.
    void fail(int what) {
        if (answer == kOkay) answer = what;
    }

    // How many of the beats from the word at `address` on, that hold bytes up to `end`, make a burst.
    static uint64_t beats(uint64_t address, uint64_t end) {
        const uint64_t last = std::min(end, (address / kBurstBytes + 1) * kBurstBytes);
        return std::min(kBurstBeats, (last - address + kWordBytes - 1) / kWordBytes);
    }

    static unsigned size_code() {
        unsigned code = 0;
        while (uint64_t{1} << code < kWordBytes) code++;
        return code;
    }

    // Addresses, beats and answers each move on by themselves, so that bursts are queued and follow each other without
    // a gap. After a refusal no further burst is asked for, and those that have been are brought to their end.
    void write_port(uint64_t begin, const uint8_t* data, uint64_t length) {
        const uint64_t end = begin + length;
        uint64_t asked = begin / kWordBytes * kWordBytes, sent = asked, burst_end = asked, unanswered = 0, i = 0;
        bool offered = false;
        top->s_axi_awsize = size_code();
        top->s_axi_awburst = kIncrementing;
        top->s_axi_bready = 1;
        for (; i < patience && answer != kStopped; i++) {
            const bool asks = asked < end && (answer == kOkay || offered), sends = sent < asked;
            if (!asks && !sends && !unanswered) break;
            const uint64_t asked_end = asked + beats(asked, end) * kWordBytes;
            top->s_axi_awvalid = asks;
            if (asks) {
                top->s_axi_awaddr = asked;
                top->s_axi_awlen = (asked_end - asked) / kWordBytes - 1;
            }
            top->s_axi_wvalid = sends;
            if (sends) {
                const uint64_t from = std::max(begin, sent), to = std::min(end, sent + kWordBytes);
                uint8_t word[kWordBytes] = {}, strobes[sizeof(top->s_axi_wstrb)] = {};
                std::memcpy(word + (from - sent), data + (from - begin), to - from);
                for (uint64_t i = from - sent; i < to - sent; i++) strobes[i / 8] |= 1 << i % 8;
                std::memcpy(&top->s_axi_wdata, word, kWordBytes);
                std::memcpy(&top->s_axi_wstrb, strobes, sizeof(strobes));
                if (sent == burst_end) burst_end += beats(sent, end) * kWordBytes;
                top->s_axi_wlast = sent + kWordBytes == burst_end;
            }
            settle();
            const bool taken = asks && top->s_axi_awready, written = sends && top->s_axi_wready;
            const bool answered = top->s_axi_bvalid;
            if (answered) check(top->s_axi_bresp);
            edge();
            if (taken) asked = asked_end;
            if (written) sent += kWordBytes;
            unanswered += taken - answered;
            offered = asks && !taken;
            if (taken || written || answered) i = 0;
        }
        if (i == patience) fail(kNoHandshake);
        top->s_axi_awvalid = top->s_axi_wvalid = top->s_axi_bready = 0;
    }

    void read_port(uint64_t begin, uint8_t* data, uint64_t length) {
        const uint64_t end = begin + length;
        uint64_t asked = begin / kWordBytes * kWordBytes, came = asked, i = 0;
        bool offered = false;
        top->s_axi_arsize = size_code();
        top->s_axi_arburst = kIncrementing;
        top->s_axi_rready = 1;
        for (; i < patience && answer != kStopped; i++) {
            const bool asks = asked < end && (answer == kOkay || offered);
            if (!asks && came == asked) break;
            const uint64_t asked_end = asked + beats(asked, end) * kWordBytes;
            top->s_axi_arvalid = asks;
            if (asks) {
                top->s_axi_araddr = asked;
                top->s_axi_arlen = (asked_end - asked) / kWordBytes - 1;
            }
            settle();
            const bool taken = asks && top->s_axi_arready, answered = top->s_axi_rvalid;
            if (answered) {
                const uint64_t from = std::max(begin, came), to = std::min(end, came + kWordBytes);
                const auto* word = reinterpret_cast<const uint8_t*>(&top->s_axi_rdata);
                std::memcpy(data + (from - begin), word + (from - came), to - from);
                check(top->s_axi_rresp);
                came += kWordBytes;
            }
            edge();
            if (taken) asked = asked_end;
            offered = asks && !taken;
            if (taken || answered) i = 0;
        }
        if (i == patience) fail(kNoHandshake);
        top->s_axi_arvalid = top->s_axi_rready = 0;
    }

    void check(unsigned response) {
        if (response) fail(kRefused + response);
    }

    // Cut a transfer into the pieces that have a backdoor and those that have none.
    template <typename Port, typename Backdoor>
    void split(uint64_t begin, uint64_t length, Port port, Backdoor backdoor) {
        for (uint64_t at = begin, stop, end = begin + length; at < end; at = stop) {
            uint8_t* memory = nullptr;
            stop = end;
            for (const Window& window : windows) {
                if (at < window.begin) stop = std::min(stop, window.begin);
                if (at < window.begin || at >= window.end) continue;
                stop = std::min(stop, window.end);
                memory = window.memory + (at - window.begin);
            }
            if (memory) backdoor(memory, at - begin, stop - at);
            else port(at, at - begin, stop - at);
        }
    }

    void write(uint64_t begin, const uint8_t* data, uint64_t length) {
        split(
            begin, length,
            [&](uint64_t at, uint64_t done, uint64_t size) { write_port(at, data + done, size); },
            [&](uint8_t* memory, uint64_t done, uint64_t size) { std::memcpy(memory, data + done, size); });
    }

    void read(uint64_t begin, uint8_t* data, uint64_t length) {
        split(
            begin, length,
            [&](uint64_t at, uint64_t done, uint64_t size) { read_states(at, data + done, size); },
            [&](uint8_t* memory, uint64_t done, uint64_t size) {
                std::memcpy(data + done, memory, size);
                if (memory == windows[kObservations].memory) PEARL_ERROR(top) &= ~kTornRead;
            });
    }

    // Row memories that a transfer has the whole of come from the back, the rest over the port.
    void read_states(uint64_t begin, uint8_t* data, uint64_t length) {
        const uint64_t end = begin + length;
        for (const RowMemory& rows : row_memories) {
            if (rows.begin == rows.end || rows.begin < begin || rows.end > end) continue;
            read_states(begin, data, rows.begin - begin);
            rows.read(data + (rows.begin - begin));
            read_states(rows.end, data + (rows.end - begin), end - rows.end);
            return;
        }
        read_port(begin, data, length);
    }

    // A call's answer; the next call starts afresh.
    int take_answer() {
        const int taken = answer;
        answer = kOkay;
        return taken;
    }
};

}  // namespace

#define PEARL_BANK(name) \
    reinterpret_cast<uint8_t*>(&model->rootp->pearl_top__DOT__u_backbone__DOT__u_##name##__DOT__u_ram__DOT__u_memory__DOT__gen_slices__DOT__gen_slice__BRA__0__KET____DOT__mem)

// PEARL_COLUMNS_OF_... list these; how many a memory has depends on the build.
#define PEARL_COLUMN_MEMORY(name, i) \
    model->rootp                     \
        ->pearl_top__DOT__u_backbone__DOT__u_state_path__DOT__u_##name##__DOT__gen_column_rams__BRA__##i##__KET____DOT__u_ram__DOT__u_memory__DOT__gen_slices__DOT__gen_slice__BRA__0__KET____DOT__mem
#define PEARL_COLUMN(name, i)                                                    \
    Column {                                                                     \
        reinterpret_cast<const uint8_t*>(&PEARL_COLUMN_MEMORY(name, i)),         \
            sizeof(PEARL_COLUMN_MEMORY(name, i)[0])                              \
    }

extern "C" {

// `bounds` are the byte addresses where each backdoor begins and ends, all 0 for none: those of the banks,
// then those of the memories of `rows` rows.
Host* pearl_open(
    PEARL_MODEL* model, VerilatedVcdC* vcd, uint64_t patience, const uint64_t* bounds, uint64_t rows
) {
    auto* host = new Host{model, vcd, patience, 0, kFirstTime, kOkay, {}, {}};
    uint8_t* banks[] = {
        PEARL_BANK(reset_mask), PEARL_BANK(actions), PEARL_BANK(observations), PEARL_BANK(rewards), PEARL_BANK(ters)};
    for (int i = 0; i < kBackdoors; i++) host->windows[i] = {bounds[2 * i], bounds[2 * i + 1], banks[i]};
    const uint64_t* states = bounds + 2 * kBackdoors;
    host->row_memories[0] = {states[0], states[1], rows, {PEARL_COLUMNS_OF_CURRENT_STATES}};
    host->row_memories[1] = {states[2], states[3], rows, {PEARL_COLUMNS_OF_ELAPSED}};
    host->enter();
    // An assertion that fails must not end the host's process.
    model->contextp()->fatalOnError(false);
    model->rst_ni = 0;
    host->cycles(1);
    model->rst_ni = 1;
    host->cycles(kDrainCycles);
    return host;
}

void pearl_close(Host* host) { delete host; }

uint64_t pearl_clock(const Host* host) { return host->clock; }

int pearl_write(Host* host, uint64_t begin, const uint8_t* data, uint64_t length) {
    host->enter();
    host->write(begin, data, length);
    return host->take_answer();
}

int pearl_read(Host* host, uint64_t begin, uint8_t* data, uint64_t length) {
    host->enter();
    host->read(begin, data, length);
    return host->take_answer();
}

// Until the interrupt, but no longer than so many clock cycles.
int pearl_wait(Host* host, uint64_t most) {
    host->enter();
    host->wait_for_end(most);
    return host->take_answer();
}

int pearl_step(
    Host* host, uint64_t write_begin, const uint8_t* written, uint64_t write_length, uint64_t read_begin,
    uint8_t* data, uint64_t read_length
) {
    host->enter();
    host->write(write_begin, written, write_length);
    if (host->answer == kOkay) host->wait_for_end(host->patience);
    if (host->answer == kOkay) host->read(read_begin, data, read_length);
    return host->take_answer();
}

}  // extern "C"
