// SPDX-License-Identifier: MIT
// Runs a step from doorbell to done: waits for the random keys, starts the pipeline, counts cycles.
module pearl_sequencer (
    input  logic        clk_i,
    input  logic        rst_ni,
    // A doorbell was accepted.
    input  logic        ring_i,
    input  logic        keys_valid_i,
    // Every result word has been written; since the last step still, in the cycle of start_o.
    input  logic        results_done_i,
    output logic        busy_o,
    output logic        start_o,
    // In the last cycle in which busy_o is high.
    output logic        done_o,
    // Cycles from the doorbell to done_o, both included.
    output logic [31:0] cycles_o
);

  // {start_o, done_o, busy_o, and one to tell two states apart}: what the outputs drive is all over the FPGA, so
  // they come from registers.
  typedef enum logic [3:0] {
    Idle     = 4'b0000,
    WaitKeys = 4'b0011,
    Start    = 4'b1010,
    Running  = 4'b0010,
    Done     = 4'b0110
  } state_e;

  state_e state_d, state_q;
  logic [31:0] cycles_q;

  always_comb begin
    state_d = state_q;
    unique case (state_q)
      Idle: if (ring_i) state_d = WaitKeys;
      WaitKeys: if (keys_valid_i) state_d = Start;
      Start: state_d = Running;
      Running: if (results_done_i) state_d = Done;
      Done: state_d = Idle;
      default: state_d = Idle;
    endcase
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      state_q  <= Idle;
      cycles_q <= '0;
    end else begin
      state_q  <= state_d;
      // The doorbell's cycle is the first, and the one after it is the second.
      cycles_q <= state_q == Idle ? 32'd2 : cycles_q + 1'b1;
    end
  end

  assign {start_o, done_o, busy_o} = state_q[3:1];
  assign cycles_o = cycles_q;

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (!ring_i || state_q == Idle)
      else $error("pearl_sequencer: a doorbell rang during a step");
    end
  end

endmodule
