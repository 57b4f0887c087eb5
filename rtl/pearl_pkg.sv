// SPDX-License-Identifier: MIT
// What host and hardware agree on beyond addresses (pearl_marl/memory_map.py and pearl_marl/golden/rng.py
// are the other side; a test compares the two), and helpers for parameter arithmetic.
package pearl_pkg;

  localparam logic [31:0] MAGIC = 32'h4C52_4150;
  localparam int unsigned PROTOCOL_VERSION = 3;

  // Cycles from a read enable to the word, of block RAM as of registers.
  localparam int unsigned READ_LATENCY = 2;

  // As wide as MAX_CYCLES, so that every limit the host can write is exact.
  localparam int unsigned ELAPSED_BITS = 32;

  // Regions of the address space, in the order of their addresses.
  typedef enum int unsigned {
    Control,
    InitialStates,
    CurrentStates,
    Elapsed,
    ResetMask,
    Actions,
    Doorbell,
    Observations,
    Rewards,
    Ters,
    Status,
    Statistics,
    Policy,
    NumRegions
  } region_e;

  // 32-bit words of the regions that are registers, and some of the control region by their index.
  localparam int unsigned CONTROL_WORDS = 16;
  localparam int unsigned DOORBELL_WORDS = 2;
  localparam int unsigned STATUS_WORDS = 3;
  localparam int unsigned STATISTICS_WORDS = 23;
  localparam int unsigned CONTROL_SEED_0 = 8;
  localparam int unsigned CONTROL_SEED_1 = 9;
  localparam int unsigned CONTROL_TICK_LOW = 10;
  localparam int unsigned CONTROL_TICK_HIGH = 11;
  localparam int unsigned CONTROL_FIRST_SLOT = 12;
  localparam int unsigned CONTROL_MAX_CYCLES = 13;
  localparam int unsigned CONTROL_RESET = 14;
  localparam int unsigned CONTROL_STEPS = 15;

  // The doorbell's mode word, least significant bit last.
  typedef struct packed {
    logic rollout;     // many steps, whose actions the policy engine chooses
    logic reset_mask;  // slots named in the reset mask start afresh
    logic reset_all;   // so do all slots
    logic stored;      // start states come from the Initial-States memory, not from random draws
    logic next_step;   // a slot that ended spends this step resetting
  } mode_t;

  // The status's error word, least significant bit last.
  typedef struct packed {
    logic reset;  // no word of the control region has been written since the hardware's reset
    logic torn_read;  // the first word of results has not been read since the last step
    logic busy_write;  // a write came during a step and was refused
    logic busy_doorbell;  // a doorbell came during a step and was refused
  } error_t;

  // What chooses actions in a rollout.
  typedef enum int unsigned {
    NoEngine,
    TableEngine,
    NetworkEngine,
    GoldenEngine,
    PlanesEngine
  } engine_e;

  // The policy region has a number of 32 bits in every word, in sections of a power of two words each.
  typedef enum int unsigned {
    Settings,
    Biases,
    Activation,
    Chances,
    Quanta,
    Scalings,
    Weights,
    NumSections
  } section_e;
  localparam int unsigned SECTION_BITS = 3;
  // Of the settings by their index: how actions are chosen, layers there are, the limit of inputs or the table's
  // first row; by how much the sums of patches are shifted; and from SETTING_LAYERS on two for each layer.
  localparam int unsigned SETTING_HEAD = 0;
  localparam int unsigned SETTING_COUNT = 1;
  localparam int unsigned SETTING_INPUT = 2;
  localparam int unsigned SETTING_SHIFT = 3;
  localparam int unsigned SETTING_LAYERS = 4;

  // Numbers in a table of activations, or of the weights of chances; and widths of these, of sums, of what rewards
  // count as, and of an episode's return.
  localparam int unsigned ENTRIES = 1024;
  localparam int unsigned ENTRY_BITS = 10;
  localparam int unsigned CHANCE_BITS = 16;
  localparam int unsigned SUM_BITS = 32;
  localparam int unsigned QUANTUM_BITS = 40;
  localparam int unsigned RETURN_BITS = 48;
  localparam int unsigned MULTIPLIER_BITS = 16;
  localparam int unsigned SHIFT_BITS = 6;
  // The index of a policy's first random draw. Those of environments come long before it.
  localparam int unsigned POLICY_DRAW = 32'h8000_0000;

  // What is to be done with a layer's sums, the lower of its two settings in the lower bits.
  typedef struct packed {
    logic        tabled;   // they are looked up; if not, cut at 0 and the limit
    logic [4:0]  shift;
    logic [25:0] limit;
    logic [15:0] outputs;
    logic [15:0] chunks;   // words of weights of an output
  } layer_t;

  // Cycles from a lane's sum to the value that it becomes.
  localparam int unsigned LANE_VALUE = 3 + READ_LATENCY;

  // Answers of the memory port, coded as AXI codes them.
  typedef enum logic [1:0] {
    RespOkay   = 2'b00,
    RespSlvErr = 2'b10,
    RespDecErr = 2'b11
  } resp_e;
  // Cycles from a request at the memory port to its answer: three to the access, the read, and two in which
  // the words of all memories come together. The AXI slave sizes its queue by it.
  localparam int unsigned PORT_LATENCY = 3 + READ_LATENCY + 2;

  // Cycles from a slot number to its random draw.
  localparam int unsigned DRAW_LATENCY = 11;
  localparam logic [31:0] CHAIN_A = 32'h243F_6A88;
  localparam logic [31:0] CHAIN_B = 32'h85A3_08D3;
  localparam logic [31:0] MULTIPLIER_1 = 32'h7FEB_352D;
  localparam logic [31:0] MULTIPLIER_2 = 32'h846C_A68B;

  // What mix32 does between its multiplications.
  function automatic logic [31:0] fold(logic [31:0] x, int unsigned by);
    return x ^ (x >> by);
  endfunction

  // Cycles from the issue of a group to when its states are read, so that they and its draws come to the
  // cores together; and to when the cores get them.
  function automatic int unsigned issue_to_read(int unsigned draws);
    return draws == 0 ? 1 : DRAW_LATENCY - READ_LATENCY - 1;
  endfunction

  function automatic int unsigned issue_to_core(int unsigned draws);
    return issue_to_read(draws) + READ_LATENCY + 1;
  endfunction

  function automatic int unsigned ceil_div(int unsigned a, int unsigned b);
    return (a + b - 1) / b;
  endfunction

  // Words of a stream of bits; the product may be more than 32 bits can count.
  function automatic int unsigned stream_words(int unsigned slots, int unsigned slot_bits,
                                               int unsigned data_wl);
    return 32'((64'(slots) * 64'(slot_bits) + 64'(data_wl) - 64'd1) / 64'(data_wl));
  endfunction

  // The word of the address space that a 32-bit register of a region is in.
  function automatic int unsigned word_index(int unsigned register, int unsigned data_wl);
    return register * 32 / data_wl;
  endfunction

  function automatic int unsigned at_least(int unsigned a, int unsigned b);
    return a > b ? a : b;
  endfunction

  // Bits that number n things; at least 1, since a port cannot have none.
  function automatic int unsigned index_bits(int unsigned n);
    return n < 2 ? 1 : $clog2(n);
  endfunction

  // The largest power of two that divides a and the power of two b.
  function automatic int unsigned common_unit(int unsigned a, int unsigned b);
    int unsigned unit = b;
    while (a % unit != 0) unit /= 2;
    return unit;
  endfunction

endpackage
