// SPDX-License-Identifier: MIT
// Control region, doorbell and status: the words in them, and what they mean to the backbone.
//
// A doorbell rings when its sequence number is written and differs from the last one that rang. So
// writing a doorbell again, or its mode alone, does nothing.
//
// While the pipeline drains after a reset, all of it reads as zero but for the identity: that there is no
// batch, the status says from the end of that on.
module pearl_registers
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned N_ENVS = 7,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned STATE_BITS = 6,
    parameter int unsigned RESULT_BITS = 9,
    // Names the environment and its options: a host refuses a build that is for another one.
    parameter logic [31:0] ENV_HASH = 32'h0,
    // The policy engine: what kind it is. With one, there is a number of steps to make.
    parameter int unsigned ENGINE = NoEngine,
    localparam int unsigned INDEX_BITS = index_bits(stream_words(CONTROL_WORDS, 32, DATA_WL))
) (
    input logic clk_i,
    input logic rst_ni,

    // The pipeline is being flushed: as good as a reset.
    input logic draining_i,

    // Word of the region, its write enables, and READ_LATENCY cycles later what each region has at it.
    input  logic [INDEX_BITS-1:0] index_i,
    input  logic                  control_we_i,
    input  logic                  doorbell_we_i,
    input  logic [   DATA_WL-1:0] wdata_i,
    // What wdata_i is in the next cycle.
    input  logic [   DATA_WL-1:0] next_wdata_i,
    output logic [   DATA_WL-1:0] control_o,
    output logic [   DATA_WL-1:0] doorbell_o,
    output logic [   DATA_WL-1:0] status_o,

    output logic               ring_o,
    output mode_t              mode_o,
    output logic  [ 1:0][31:0] seed_o,
    output logic  [63:0]       tick_o,
    // In the cycle in which seed_o or the high word of tick_o may be new; in which only the low word is, by one.
    output logic               keys_stale_o,
    output logic               keys_next_o,
    output logic  [31:0]       first_slot_o,
    // Whether there is a time limit, and the limit less one, to compare with.
    output logic               limited_o,
    output logic  [31:0]       limit_o,
    // Of a rollout.
    output logic  [31:0]       steps_o,

    // A step is done; it is the last one of its doorbell.
    input logic        done_i,
    input logic        last_i,
    input logic [31:0] cycles_i,
    // A write, or a doorbell, was refused because a step was running.
    input logic        busy_write_i,
    input logic        busy_doorbell_i,
    // The first word of results is read while no step runs.
    input logic        untorn_i
);

  localparam int unsigned CONTROL_BITS = stream_words(CONTROL_WORDS, 32, DATA_WL) * DATA_WL;
  localparam int unsigned DOORBELL_BITS = stream_words(DOORBELL_WORDS, 32, DATA_WL) * DATA_WL;
  localparam int unsigned STATUS_BITS = stream_words(STATUS_WORDS, 32, DATA_WL) * DATA_WL;

  logic [1:0][31:0] seed_q;
  logic [63:0] tick_q;
  logic [31:0] first_slot_q, max_cycles_q, steps_q, limit_q, mode_word_q, sequence_q, finished_q, cycles_q;
  logic [DOORBELL_WORDS-1:0] doorbell_we;
  error_t error_q  /* verilator public_flat_rw */;
  error_t error;
  logic clear, limited_q, stale_q, next_q, new_q, carries_q;

  assign clear = !rst_ni || draining_i;

  // Whether the word at an index of the address space holds a 32-bit register, and the register in it.
  function automatic logic reaches(int unsigned register, logic [INDEX_BITS-1:0] index);
    return 32'(index) == word_index(register, DATA_WL);
  endfunction

  function automatic logic [31:0] word_of(int unsigned register, logic [DATA_WL-1:0] data);
    return data[register*32%DATA_WL+:32];
  endfunction

  always_ff @(posedge clk_i) begin
    if (clear) begin
      seed_q       <= '0;
      tick_q       <= '0;
      first_slot_q <= '0;
      max_cycles_q <= '0;
      steps_q      <= '0;
      stale_q      <= 1'b1;
      next_q       <= 1'b0;
    end else begin
      stale_q <= control_we_i || (done_i && carries_q);
      next_q  <= done_i && !carries_q;
      if (done_i) tick_q <= tick_q + 1'b1;
      if (control_we_i) begin
        if (reaches(CONTROL_SEED_0, index_i)) seed_q[0] <= word_of(CONTROL_SEED_0, wdata_i);
        if (reaches(CONTROL_SEED_1, index_i)) seed_q[1] <= word_of(CONTROL_SEED_1, wdata_i);
        if (reaches(CONTROL_TICK_LOW, index_i)) tick_q[31:0] <= word_of(CONTROL_TICK_LOW, wdata_i);
        if (reaches(CONTROL_TICK_HIGH, index_i)) begin
          tick_q[63:32] <= word_of(CONTROL_TICK_HIGH, wdata_i);
        end
        if (reaches(CONTROL_FIRST_SLOT, index_i)) begin
          first_slot_q <= word_of(CONTROL_FIRST_SLOT, wdata_i);
        end
        if (reaches(CONTROL_MAX_CYCLES, index_i)) begin
          max_cycles_q <= word_of(CONTROL_MAX_CYCLES, wdata_i);
        end
        if (ENGINE != NoEngine && reaches(CONTROL_STEPS, index_i)) steps_q <= word_of(CONTROL_STEPS, wdata_i);
      end
    end
  end

  // Known before done_i comes, some cycles after the tick was written.
  always_ff @(posedge clk_i) begin
    carries_q <= tick_q[31:0] == '1;
    limited_q <= max_cycles_q != '0;
    limit_q   <= max_cycles_q - 1'b1;
  end

  for (genvar i = 0; i < DOORBELL_WORDS; i++) begin : gen_doorbell_we
    assign doorbell_we[i] = doorbell_we_i && reaches(i, index_i);
  end

  // What was written last also rang last: it either rings or is the same.
  // It is compared a cycle before it is written; a doorbell that rings in that cycle keeps out the next one.
  always_ff @(posedge clk_i) new_q <= word_of(1, next_wdata_i) != sequence_q;
  assign ring_o = doorbell_we[1] && new_q;

  always_ff @(posedge clk_i) begin
    if (clear) begin
      mode_word_q <= '0;
      sequence_q  <= '0;
      finished_q  <= '0;
      cycles_q    <= '0;
      error_q     <= '{reset: 1'b1, default: 1'b0};
    end else begin
      if (doorbell_we[0]) mode_word_q <= word_of(0, wdata_i);
      if (doorbell_we[1]) sequence_q <= word_of(1, wdata_i);
      if (untorn_i) error_q.torn_read <= 1'b0;
      if (ring_o) begin
        error_q.torn_read <= 1'b1;
        error_q.busy_write <= 1'b0;
        error_q.busy_doorbell <= 1'b0;
      end
      if (control_we_i) error_q.reset <= 1'b0;
      if (busy_write_i) error_q.busy_write <= 1'b1;
      if (busy_doorbell_i) error_q.busy_doorbell <= 1'b1;
      if (done_i && last_i) begin
        finished_q <= sequence_q;
        cycles_q   <= cycles_i;
      end
    end
  end

  logic [ CONTROL_BITS-1:0] control;
  logic [DOORBELL_BITS-1:0] doorbell;
  logic [  STATUS_BITS-1:0] status;

  // The word that resets reads as zero.
  assign control = CONTROL_BITS'({
    steps_q,
    32'h0,
    max_cycles_q,
    first_slot_q,
    tick_q,
    seed_q,
    RESULT_BITS,
    STATE_BITS,
    DATA_WL,
    PE_NUM,
    N_ENVS,
    ENV_HASH,
    16'(ENGINE),
    16'(PROTOCOL_VERSION),
    MAGIC
  });
  assign doorbell = DOORBELL_BITS'({sequence_q, mode_word_q});
  // A reader that finds a new sequence number in the first word has yet to read the other two, so
  // they cannot be those of the step before, however narrow its words are.
  assign status = STATUS_BITS'({32'(error), cycles_q, finished_q});

  always_comb begin
    error = error_q;
    if (draining_i) error.reset = 1'b0;
  end

  // What the registers hold one cycle after the address.
  logic [INDEX_BITS-1:0] index_q;
  logic [DATA_WL-1:0] control_word, doorbell_word, status_word;
  always_ff @(posedge clk_i) index_q <= index_i;

  always_comb begin
    control_word  = '0;
    doorbell_word = '0;
    status_word   = '0;
    for (int unsigned i = 0; i < CONTROL_BITS / DATA_WL; i++) begin
      if (32'(index_q) == i) control_word = control[i*DATA_WL+:DATA_WL];
    end
    for (int unsigned i = 0; i < DOORBELL_BITS / DATA_WL; i++) begin
      if (32'(index_q) == i) doorbell_word = doorbell[i*DATA_WL+:DATA_WL];
    end
    for (int unsigned i = 0; i < STATUS_BITS / DATA_WL; i++) begin
      if (32'(index_q) == i) status_word = status[i*DATA_WL+:DATA_WL];
    end
  end

  pearl_delay #(
      .WIDTH (3 * DATA_WL),
      .STAGES(READ_LATENCY - 1)
  ) u_read (
      .clk_i,
      .d_i({control_word, doorbell_word, status_word}),
      .d_o({control_o, doorbell_o, status_o})
  );

  assign mode_o = mode_t'(mode_word_q[$bits(mode_t)-1:0]);
  assign seed_o = seed_q;
  assign tick_o = tick_q;
  assign keys_stale_o = stale_q;
  assign keys_next_o = next_q;
  assign first_slot_o = first_slot_q;
  assign limited_o = limited_q;
  assign limit_o = limit_q;
  assign steps_o = steps_q;

  always_ff @(posedge clk_i) begin
    if (!clear) begin
      assert (!done_i || !control_we_i)
      else $error("pearl_registers: the tick was written in the cycle in which it counts");
    end
  end

endmodule
